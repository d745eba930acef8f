#include "common/joint_errors/backlash.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

const JointErrorParameters kJoint = {.B = 0.01};

TEST(Backlash, StartsMidGapAndFollowsAfterHalfTheGap) {
  Backlash backlash;
  backlash.Reset(1.0);
  EXPECT_DOUBLE_EQ(backlash.Step(kJoint, 1.0), 0);
  EXPECT_NEAR(backlash.Step(kJoint, 1.009), -0.009, 1e-15);  // the link stays
  EXPECT_NEAR(backlash.Step(kJoint, 1.05), -0.01, 1e-15);    // pushed, B behind
  EXPECT_NEAR(backlash.link_angle(), 1.04, 1e-15);
}

TEST(Backlash, ReversalLosesTheWholeGap) {
  Backlash backlash;
  backlash.Reset(0);
  backlash.Step(kJoint, 0.05);
  const double link = backlash.link_angle();
  backlash.Step(kJoint, 0.05 - 0.0199);
  EXPECT_DOUBLE_EQ(backlash.link_angle(), link);
  backlash.Step(kJoint, 0.05 - 0.0201);
  EXPECT_NEAR(backlash.link_angle(), link - 0.0001, 1e-15);
}

TEST(Backlash, IsThePlayOperatorAndStaysWithinTheGap) {
  Backlash backlash;
  backlash.Reset(0);
  double play = 0;  // closed form of one step: the previous link angle clamped to the motor's gap
  for (int t = 0; t < 2000; ++t) {
    const double q = 0.03 * std::sin(0.01 * t) + 0.012 * std::sin(0.137 * t);
    play = std::clamp(play, q - kJoint.B, q + kJoint.B);
    const double eta = backlash.Step(kJoint, q);
    EXPECT_NEAR(eta, play - q, 1e-15);
    EXPECT_LE(std::abs(eta), kJoint.B + 1e-15);
  }
}

}  // namespace
}  // namespace robostress
