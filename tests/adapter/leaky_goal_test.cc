#include "adapter/leaky_goal.h"

#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;

LeakyGoal Make(double memory, double limit = 10) {
  const MethodOptions method = *MakeMethod(
      "base", {absl::StrCat("goal_memory=", memory), absl::StrCat("goal_limit=", limit)});
  return LeakyGoal(*method.Find<LeakyGoalOptions>(), ResidualOptionsOf(method), {});
}

// Corrected at every step.
void Drive(LeakyGoal& goal, DisturbedArm& arm, const Vector6& command, int steps) {
  for (int i = 0; i < steps; ++i)
    goal.Observe(arm.Execute(command, -Vector6(goal.correction()), 1));
}

TEST(LeakyGoal, AConstantCommandMovesTheArmByItsClosedForm) {
  constexpr double kGain = 0.267, kMemory = 0.5;
  LeakyGoal goal = Make(kMemory);
  DisturbedArm arm(1, Vector6::Zero());
  const Vector6 command = (Vector6() << 0.2, -0.1, 0.05, 0.02, 0, -0.04).finished();
  Drive(goal, arm, command, 60);
  const Vector6 expected = kGain / (1 - kMemory * (1 - kGain)) * command;
  EXPECT_LT((arm.last_motion() - expected).cwiseAbs().maxCoeff(), 2e-3);
}

TEST(LeakyGoal, AnArmThatIsHeldGetsNoMoreThanTheLimit) {
  LeakyGoal goal = Make(1, 0.3);
  DisturbedArm arm(0, Vector6::Zero());
  Drive(goal, arm, 0.4 * Vector6::Unit(0), 50);
  EXPECT_EQ(goal.correction()[0], 0.3);
}

TEST(LeakyGoal, AnEpisodeBeginsWithoutAGoalAndAMaskedStepLeavesIt) {
  LeakyGoal goal = Make(0.5);
  DisturbedArm arm(0.5, Vector6::Zero());
  ExecutedChunk chunk = arm.Execute(0.4 * Vector6::Unit(1), Vector6::Zero(), 2);
  chunk.masked = {false, true};
  goal.Observe(chunk);
  const Eigen::VectorXd after_first = goal.correction();
  EXPECT_GT(after_first[1], 0);
  LeakyGoal alone = Make(0.5);
  chunk.final_state = chunk.steps[1].before;
  chunk.steps.pop_back();
  chunk.masked.clear();
  alone.Observe(chunk);
  EXPECT_EQ(alone.correction(), after_first);
  goal.StartEpisode();
  EXPECT_EQ(goal.correction(), Vector6::Zero());
}

}  // namespace
}  // namespace robostress
