#include "adapter/pseudo_target.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

Eigen::VectorXf Command() {
  return (Eigen::VectorXf(7) << 0.5f, -0.25f, 0.8f, 0.1f, -0.2f, 0.3f, -0.9f).finished();
}

Eigen::MatrixXf Target(const ExecutedChunk& chunk, TargetReference reference,
                       const Eigen::MatrixXf& base = {}, NominalArm* arm = nullptr) {
  return PseudoTarget(chunk, *ReferencedResidual(chunk, reference, {}, base, arm));
}

TEST(PseudoTarget, OfAnArmThatTracksWithGainGIsTwoMinusGTimesTheCommand) {
  const double g = 0.6;
  const ExecutedChunk chunk = ToyArm(g).Execute(ConstantPrediction(Command(), 5), 5);
  const Eigen::MatrixXf target = Target(chunk, TargetReference::kExecuted);
  for (int i = 0; i < 5; ++i) {
    EXPECT_LT((target.row(i).head<6>() - (2 - g) * Command().head<6>().transpose()).norm(), 1e-6);
  }
}

TEST(PseudoTarget, KeepsTheGripperCommandBitForBit) {
  const ExecutedChunk chunk = ToyArm(0.3).Execute(ConstantPrediction(Command(), 5), 4);
  const Eigen::MatrixXf target = Target(chunk, TargetReference::kExecuted);
  ASSERT_EQ(target.rows(), 4);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(target(i, 6), -0.9f);
}

TEST(PseudoTarget, AgainstIntentHasAFixedPointWhereTheMotionIsWhatTheBasePolicyWanted) {
  // The adapted policy asks for base / g, the arm delivers base: nothing is left to correct.
  const double g = 0.5;
  PredictedChunk prediction = ConstantPrediction(Command(), 5);
  Eigen::MatrixXf base = prediction.policy_actions;
  base.leftCols(6) *= static_cast<float>(g);
  const ExecutedChunk chunk = ToyArm(g).Execute(prediction, 5);
  EXPECT_LT((Target(chunk, TargetReference::kIntent, base) - prediction.policy_actions.topRows(5))
                .cwiseAbs()
                .maxCoeff(),
            1e-6f);
  EXPECT_GT((Target(chunk, TargetReference::kExecuted) - prediction.policy_actions.topRows(5))
                .cwiseAbs()
                .maxCoeff(),
            0.3f);
}

TEST(PseudoTarget, AgainstIntentNeedsTheBaseCommands) {
  const ExecutedChunk chunk = ToyArm(1).Execute(ConstantPrediction(Command(), 5), 5);
  EXPECT_EQ(ReferencedResidual(chunk, TargetReference::kIntent, {}, {}, nullptr).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(PseudoTarget, AgainstTheNominalArmIsTheCommandItselfForANominalArm) {
  // An arm that moves as the nominal model does, lag and all, over three chunks.
  NominalArm truth({}), model({});
  RobotState state = ToyArm(1).state();
  for (int c = 0; c < 3; ++c) {
    ExecutedChunk chunk;
    for (int i = 0; i < 5; ++i) {
      ExecutedStep step;
      step.before = state;
      step.policy_command = step.sent_command = Command() * (1.0f - 0.3f * c);
      const NominalArm::Vector6 delta = truth.Step(step.sent_command.head<6>().cast<double>());
      state.tool.p_base_tool += 0.05 * delta.head<3>();
      state.tool.q_base_tool = ExpSo3(0.5 * delta.tail<3>()) * state.tool.q_base_tool;
      chunk.steps.push_back(step);
    }
    chunk.final_state = state;
    const Eigen::MatrixXf target = Target(chunk, TargetReference::kNominal, {}, &model);
    for (int i = 0; i < 5; ++i) {
      EXPECT_LT((target.row(i).transpose() - chunk.steps[i].policy_command).norm(), 1e-5);
    }
  }
}

TEST(PseudoTarget, AgainstTheNominalArmGoesByWhatWasSentNotByWhatThePolicyAsked) {
  // The arm is nominal and gets half of the policy's command: it did what it was told, so nothing
  // is left to learn, and the target is the policy's own command.
  NominalArm truth({}), model({});
  RobotState state = ToyArm(1).state();
  ExecutedChunk chunk;
  for (int i = 0; i < 5; ++i) {
    ExecutedStep step;
    step.before = state;
    step.policy_command = Command();
    step.sent_command = 0.5f * Command();
    const NominalArm::Vector6 delta = truth.Step(step.sent_command.head<6>().cast<double>());
    state.tool.p_base_tool += 0.05 * delta.head<3>();
    state.tool.q_base_tool = ExpSo3(0.5 * delta.tail<3>()) * state.tool.q_base_tool;
    chunk.steps.push_back(step);
  }
  chunk.final_state = state;
  const Eigen::MatrixXf target = Target(chunk, TargetReference::kNominal, {}, &model);
  for (int i = 0; i < 5; ++i) EXPECT_LT((target.row(i).transpose() - Command()).norm(), 1e-5) << i;
}

TEST(PseudoTarget, AgainstTheNominalArmsAnswerToTheUnadaptedCommandHasAFixedPointThere) {
  // The adapted policy asks for twice as much of an arm that does half of it: it moves as a nominal
  // arm moves by the unadapted command, and nothing is left to learn. An arm that does all of it
  // goes too far by what the nominal arm does.
  for (const double gain : {0.5, 1.0}) {
    NominalArm truth({}), model({});
    RobotState state = ToyArm(1).state();
    ExecutedChunk chunk;
    Eigen::MatrixXf base(5, 7);
    Eigen::MatrixXd beyond = Eigen::MatrixXd::Zero(5, 7);
    for (int i = 0; i < 5; ++i) {
      ExecutedStep step;
      step.before = state;
      step.policy_command = step.sent_command = 2.0f * Command();
      base.row(i) = Command().transpose();
      const NominalArm::Vector6 nominal = truth.Step(Command().head<6>().cast<double>());
      const NominalArm::Vector6 delta = 2 * gain * nominal;
      beyond.row(i).head<6>() = (delta - nominal).transpose();
      state.tool.p_base_tool += 0.05 * delta.head<3>();
      state.tool.q_base_tool = ExpSo3(0.5 * delta.tail<3>()) * state.tool.q_base_tool;
      chunk.steps.push_back(step);
    }
    chunk.final_state = state;
    const auto residual =
        ReferencedResidual(chunk, TargetReference::kNominalIntent, {}, base, &model);
    ASSERT_TRUE(residual.ok()) << residual.status();
    EXPECT_LT((*residual - beyond).cwiseAbs().maxCoeff(), 1e-5) << gain;
  }
  const ExecutedChunk chunk = ToyArm(1).Execute(ConstantPrediction(Command(), 5), 5);
  NominalArm arm({});
  EXPECT_EQ(
      ReferencedResidual(chunk, TargetReference::kNominalIntent, {}, {}, &arm).status().code(),
      absl::StatusCode::kFailedPrecondition);
}

TEST(PseudoTarget, OfSentCommandsIsTheUnadaptedChunkWithTheExecutedRowsAsTheyWereSent) {
  PredictedChunk prediction = ConstantPrediction(Command(), 5);
  prediction.policy_actions *= 1.5f;
  prediction.actions *= 2.0f;
  ExecutedChunk chunk = ToyArm(0.6).Execute(prediction, 3, 1);
  chunk.masked = {false, true, false};
  const Eigen::MatrixXf target = SentTarget(chunk, prediction.base_actions);
  ASSERT_EQ(target.rows(), 5);
  for (int i = 0; i < 5; ++i) {
    const float factor = i == 1 || i == 3 ? 2.0f : 1.0f;  // row 2 is masked
    EXPECT_EQ(target.row(i).head<6>(), factor * Command().head<6>().transpose()) << i;
    EXPECT_EQ(target(i, 6), Command()[6]) << "the gripper is never corrected";
  }
  // Nothing to correct, nothing learned: the fixed point.
  EXPECT_EQ(
      SentTarget(ToyArm(1).Execute(ConstantPrediction(Command(), 5), 5), prediction.base_actions),
      prediction.base_actions);
}

TEST(PseudoTarget, TakesTheGripperFromThePolicyWhateverStandsInTheResidual) {
  const ExecutedChunk chunk = ToyArm(1).Execute(ConstantPrediction(Command(), 2), 2);
  const Eigen::MatrixXf target = PseudoTarget(chunk, Eigen::MatrixXd::Constant(2, 7, 0.25));
  EXPECT_EQ(target(1, 6), -0.9f);
  EXPECT_NEAR(target(1, 0), 0.25, 1e-6);
}

}  // namespace
}  // namespace robostress
