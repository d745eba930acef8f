#include "adapter/residual.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "common/so3.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

Eigen::VectorXf Action(std::initializer_list<float> values) {
  Eigen::VectorXf action(values.size());
  std::copy(values.begin(), values.end(), action.data());
  return action;
}

const Eigen::Vector3d kOrigin = Eigen::Vector3d::Zero();

RobotState StateAt(const Eigen::Vector3d& p, const Eigen::Quaterniond& q) {
  RobotState state;
  state.tool.p_base_tool = p;
  state.tool.q_base_tool = q;
  state.q = state.dq = Eigen::VectorXd::Zero(7);
  return state;
}

TEST(Residual, IsAchievedMinusCommandedInCommandUnits) {
  const RobotState before = StateAt({0.1, 0.2, 0.3}, Eigen::Quaterniond::Identity());
  const RobotState after =
      StateAt({0.1 + 0.05 * 0.25, 0.2, 0.3 - 0.05 * 0.5}, ExpSo3(Eigen::Vector3d(0, 0.5 * 0.4, 0)));
  const Eigen::VectorXd eta =
      StepResidual(before, after, Action({1, 0.5, -1, 0, 0.4f, 0.2f, 1}), {});
  const Eigen::VectorXd expected =
      (Eigen::VectorXd(7) << 0.25 - 1, -0.5, -0.5 + 1, 0, 0, -0.2, 0).finished();
  EXPECT_LT((eta - expected).cwiseAbs().maxCoeff(), 1e-7);  // 0.4f is not 0.4
}

TEST(Residual, RotatesInTheWorldFrameWhateverTheToolOrientation) {
  const Eigen::Quaterniond start = ExpSo3({2.0, -1.0, 0.5});
  const Eigen::Vector3d omega(0.1, -0.2, 0.15);
  const Eigen::VectorXd delta =
      AchievedDelta(StateAt(kOrigin, start), StateAt(kOrigin, ExpSo3(omega) * start), {});
  EXPECT_LT((delta.tail<3>() * 0.5 - omega).norm(), 1e-12);
}

TEST(Residual, TakesTheShortPathAcrossTheAntipode) {
  // The tool turns by 0.02 rad while its axis-angle chart jumps from +pi - 0.01 to -(pi - 0.01),
  // and its quaternion may come with either sign.
  const double pi = std::numbers::pi;
  const Eigen::Quaterniond before = ExpSo3({pi - 0.01, 0, 0});
  Eigen::Quaterniond after = ExpSo3({-(pi - 0.01), 0, 0});
  for (const double sign : {1.0, -1.0}) {
    after.coeffs() *= sign;
    const Eigen::VectorXd delta =
        AchievedDelta(StateAt(kOrigin, before), StateAt(kOrigin, after), {});
    EXPECT_NEAR(delta[3] * 0.5, 0.02, 1e-9);
    EXPECT_NEAR(delta.segment<2>(4).norm(), 0, 1e-9);
  }
}

TEST(Residual, ExcludesTheGripperBitForBit) {
  const RobotState before = StateAt(kOrigin, Eigen::Quaterniond::Identity());
  const Eigen::VectorXd eta = StepResidual(before, before, Action({0, 0, 0, 0, 0, 0, -0.7f}), {});
  EXPECT_EQ(eta[6], 0.0);
}

TEST(Residual, IsTakenAgainstTheClippedCommandUnlessToldOtherwise) {
  const RobotState still = StateAt(kOrigin, Eigen::Quaterniond::Identity());
  const Eigen::VectorXf command = Action({2.5f, -3, 0.5f, 0, 0, 0, 1});
  ResidualOptions options;
  EXPECT_EQ(StepResidual(still, still, command, options)[0], -1);
  EXPECT_EQ(StepResidual(still, still, command, options)[1], 1);
  options.clip_command = false;
  EXPECT_EQ(StepResidual(still, still, command, options)[0], -2.5);
  EXPECT_EQ(StepResidual(still, still, command, options)[1], 3);
}

TEST(Residual, TrackingScaleVanishesForAnArmThatFollowsWithTheTrackingGain) {
  ToyArm arm(0.267);
  const auto prediction = ConstantPrediction(Action({0.5f, -0.25f, 1, 0.1f, 0, -0.5f, 1}), 5);
  ResidualOptions options;
  options.scale = ResidualScale::kTracking;
  EXPECT_LT(ChunkResidual(arm.Execute(prediction, 5), options).cwiseAbs().maxCoeff(), 1e-9);
  options.scale = ResidualScale::kCommand;
  const Eigen::MatrixXd eta = ChunkResidual(arm.Execute(prediction, 5), options);
  EXPECT_NEAR(eta(2, 2), 0.267 - 1, 1e-9);
}

TEST(Residual, InJointSpaceIsTheMeasuredJointMinusItsTarget) {
  RobotState before, after;
  before.q = Eigen::VectorXd::Zero(6);
  after.q = Eigen::VectorXd::LinSpaced(6, 0.1, 0.6);
  ResidualOptions options;
  options.space = ResidualSpace::kJoint;
  // 1.9 rad is not clipped: it is a joint target, not a normalised command.
  const Eigen::VectorXd eta =
      StepResidual(before, after, Action({0.1f, 0.2f, 0.25f, 1.9f, 0.5f, 0.6f, 0.03f}), options);
  const Eigen::VectorXd expected = (Eigen::VectorXd(7) << 0, 0, 0.05, -1.5, 0, 0, 0).finished();
  EXPECT_LT((eta - expected).cwiseAbs().maxCoeff(), 1e-6);
}

TEST(Residual, ReadsTheStateAfterEachStepFromTheNextStepAndTheChunkEnd) {
  ToyArm arm(1);
  const ExecutedChunk chunk = arm.Execute(ConstantPrediction(Action({1, 0, 0, 0, 0, 0, 1}), 5), 3);
  EXPECT_EQ(&StateAfter(chunk, 0), &chunk.steps[1].before);
  EXPECT_EQ(&StateAfter(chunk, 2), &chunk.final_state);
  EXPECT_LT(ChunkResidual(chunk, {}).cwiseAbs().maxCoeff(), 1e-12);
}

class Validation : public ::testing::Test {
 protected:
  ExecutedChunk chunk_ = ToyArm(1).Execute(ConstantPrediction(Action({1, 0, 0, 0, 0, 0, 1}), 5), 3);
  std::string Message() {
    return std::string(ValidateExecutedChunk(chunk_, 7, ResidualSpace::kEndEffector).message());
  }
};

TEST_F(Validation, AcceptsAnExecutedChunk) { EXPECT_EQ(Message(), ""); }

TEST_F(Validation, NamesStepAndFieldOfAValueThatIsNotFinite) {
  chunk_.steps[1].policy_command[3] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(Message(), HasSubstr("step 1: policy_command[3] is nan"));
}

TEST_F(Validation, RefusesAQuaternionThatIsNotAUnit) {
  chunk_.final_state.tool.q_base_tool.coeffs() *= 1.5;
  EXPECT_THAT(Message(), HasSubstr("after.tool.q_base_tool has length 1.5"));
}

TEST_F(Validation, RefusesAnEmptyChunkAndShortCommands) {
  chunk_.steps[0].sent_command.resize(6);
  EXPECT_THAT(Message(), HasSubstr("sent_command has 6 entries"));
  chunk_.steps.clear();
  EXPECT_THAT(Message(), HasSubstr("has no steps"));
}

TEST(Residual, OfAChunkIsAgainstThePolicysCommandNotAgainstWhatACorrectionMadeOfIt) {
  // The arm does exactly what was sent: twice what the policy asked for.
  PredictedChunk prediction = ConstantPrediction(Action({0.2f, 0, 0.1f, 0, 0.1f, 0, 1}), 3);
  prediction.actions = 2 * prediction.policy_actions;
  const Eigen::MatrixXd eta = ChunkResidual(ToyArm(1).Execute(prediction, 3), {});
  for (int i = 0; i < 3; ++i)
    EXPECT_LT((eta.row(i).head(6) - prediction.policy_actions.row(i).head(6).cast<double>()).norm(),
              1e-6);
}

}  // namespace
}  // namespace robostress
