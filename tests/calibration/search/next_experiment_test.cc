#include "calibration/search/next_experiment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/calibration/search/brief_machine.h"

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

TEST_F(NextExperimentTest, OfWhatTheServoHidesIsASensorOfTorque) {
  JointModel weak = model_, heavy = model_;
  weak.torque_gain = 0.95;
  heavy.mass_scale /= 0.95;
  heavy.armature /= 0.95;
  heavy.damping /= 0.95;
  EXPECT_THAT(Propose({weak, heavy}).what, testing::HasSubstr("with a known"));
  std::vector<JointTrack> tracks = rig_.Problem(0).tracks();
  for (JointTrack& track : tracks) track.rows[0].payload_inertia = 0;  // nothing can be hung on it
  JointProblem problem("hinge", tracks, 50);
  const NextExperiment next = ProposeExperiment(problem, {weak, heavy});
  EXPECT_EQ(next.what, "");
  EXPECT_EQ(next.sensor.what, "the motor's torque");
  EXPECT_TRUE(next.sensor.torque);
  EXPECT_GT(next.sensor.apart, 0);
}

TEST_F(NextExperimentTest, OfAnEncoderThatIsOffIsAnInstrumentOutside) {
  model_.servo.feedback = ServoFeedback::kLink;
  JointModel gear = model_, encoder = model_;
  gear.effects.push_back({*FindEffect("transmission_error"), {0.01, 0, 2 * M_PI}});
  encoder.effects.push_back({*FindEffect("encoder_eccentricity"), {0.01, 0, 2 * M_PI}});
  const NextExperiment next = Propose({gear, encoder});
  EXPECT_EQ(next.sensor.what, "the joint's angle by an instrument outside");
  EXPECT_FALSE(next.sensor.torque);
}

TEST_F(NextExperimentTest, IsNoneWhereNothingDiffers) {
  EXPECT_EQ(Propose({model_}).what, "");
  EXPECT_EQ(Propose({model_, model_}).what, "");
}

}  // namespace
}  // namespace robostress::calibration
