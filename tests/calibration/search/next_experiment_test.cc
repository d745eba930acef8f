#include "calibration/search/next_experiment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/calibration/search/brief_servo.h"

namespace robostress::calibration {
namespace {

using testing::EndsWith;
using testing::StartsWith;

class NextExperimentTest : public BriefServo {
 protected:
  void SetUp() override {
    BriefServo::SetUp();
    if (HasFatalFailure()) return;
    model_ = rig_.Declared(0)->model;
    model_.frictionloss = 0;
    model_.effects.clear();
  }
  NextExperiment Propose(const std::vector<JointModel>& models) {
    return ProposeExperiment(rig_.Problem(0), models);
  }
  JointModel WithOffset(double torque) const {
    JointModel model = model_;
    model.torque_offset += torque;
    return model;
  }

  JointModel model_;
};

TEST_F(NextExperimentTest, OfATorqueThatAServoHoldsIsOneAtLowerGains) {
  const NextExperiment next = Propose({model_, WithOffset(0.01 * model_.servo.kp)});
  EXPECT_THAT(next.what, StartsWith("the motion of log_"));
  EXPECT_THAT(next.what, EndsWith("at half the servo's gains"));
  EXPECT_FALSE(next.torque);
  // The joint stands off by torque / kp where a free run has come to rest.
  EXPECT_GT(next.apart, 1.3 * next.now);
  EXPECT_LT(next.apart, 2.2 * next.now);
  EXPECT_NEAR(next.now, 0.01, 0.005);
}

TEST_F(NextExperimentTest, OfViscousFrictionIsAFastOneInTorque) {
  for (MeasuredLog& log : rig_.logs) log.joints[0].tau.assign(log.rows, 0);
  model_.input = JointInput::kTorque;
  JointModel other = model_;
  other.damping += 0.1;
  const NextExperiment next = Propose({model_, other});
  EXPECT_THAT(next.what, EndsWith("at twice the speed"));
  EXPECT_TRUE(next.torque);
  EXPECT_NEAR(next.apart, 2 * next.now, 0.02 * next.now);  // 0.1 dq, at twice dq
}

TEST_F(NextExperimentTest, TellsTheFirstFromTheNearestOfTheOthers) {
  const JointModel near = WithOffset(0.001 * model_.servo.kp),
                   far = WithOffset(0.01 * model_.servo.kp);
  const double alone = Propose({model_, near}).apart;
  EXPECT_DOUBLE_EQ(Propose({model_, far, near}).apart, alone);
  EXPECT_DOUBLE_EQ(Propose({model_, near, far}).apart, alone);
}

TEST_F(NextExperimentTest, IsNoneWhereNothingDiffers) {
  EXPECT_EQ(Propose({model_}).what, "");
  EXPECT_EQ(Propose({model_, model_}).what, "");
}

}  // namespace
}  // namespace robostress::calibration
