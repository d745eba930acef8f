#include "common/joint_errors/effects/backlash.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "common/random.h"

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

// A motor that reverses again and again, by strokes from a billionth of B to thirty of them, each
// cut into random sub-steps. Over one stroke the play operator has a closed form that knows no
// steps (Brokate and Sprekels, Hysteresis and Phase Transitions, sec. 2.3): from (q0, l0) to q,
//   forwards l = max(l0, q - B),  backwards l = min(l0, q + B).
void ReverseAtRandom(double B, int seed) {
  RandomStream random(StreamKey("reversals").With(seed));
  const JointErrorParameters joint = {.B = B};
  Backlash backlash;
  double q = random.Uniform(-1, 1), link = q;
  backlash.Reset(q);
  for (int stroke = 0; stroke < 400; ++stroke) {
    const double direction = stroke % 2 ? 1 : -1, l0 = link;
    const double size = B * std::pow(10, random.Uniform(-9, 1.5));
    const int pieces = 1 + random.UniformInt(8);
    const double from = q;
    for (int k = 1; k <= pieces; ++k) {
      q = from + direction * size * k / pieces;
      link = direction > 0 ? std::max(l0, q - B) : std::min(l0, q + B);
      const double eta = backlash.Step(joint, q);
      ASSERT_NEAR(backlash.link_angle(), link, 1e-14) << "stroke " << stroke << " of " << size;
      ASSERT_NEAR(eta, link - q, 1e-14);
      ASSERT_LE(std::abs(eta), B + 1e-14);
    }
    // A stroke moves the link by what is beyond the gap that was left, and never backwards.
    ASSERT_GE(direction * (link - l0), 0);
    ASSERT_NEAR(direction * (link - l0), std::max(0.0, size - B - direction * (l0 - from)), 1e-14);
  }
}

TEST(Backlash, IsADeadbandOnReversalsOfAnySizeAtEverySeverity) {
  int seed = 0;
  for (const int j : {0, 6}) {
    for (const double w : {1.0, 5.0, 7.5, 10.0, 12.5, 15.0}) {
      ReverseAtRandom(Scale(NominalPandaErrors()[j], {.backlash = w}).B, ++seed);
    }
  }
}

TEST(Backlash, AGapThatWidensInMotionStaysABound) {
  // Thermal Drift-Backlash: B grows between the steps.
  RandomStream random(StreamKey("widening"));
  JointErrorParameters joint = NominalPandaErrors()[4];
  Backlash backlash;
  backlash.Reset(0);
  double q = 0;
  for (int t = 0; t < 5000; ++t) {
    joint.B = 0.0013 * (5 + 10 * t / 5000.0);
    q += random.Normal() * 0.004;
    EXPECT_LE(std::abs(backlash.Step(joint, q)), joint.B + 1e-15);
  }
}

}  // namespace
}  // namespace robostress
