#include "common/rollout/replay_chunks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/common/rollout/fake_robot.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// Chunks of 2 and 1 steps whose sent command is twice the policy's.
std::vector<ExecutedChunk> Recorded() {
  std::vector<ExecutedChunk> chunks(2);
  chunks[0].steps.resize(2);
  chunks[1].steps.resize(1);
  float command = 0.1f;
  for (ExecutedChunk& chunk : chunks) {
    for (ExecutedStep& step : chunk.steps) {
      step.policy_command = Eigen::VectorXf::Constant(7, command);
      step.sent_command = 2 * step.policy_command;
      command += 0.1f;
    }
  }
  return chunks;
}

TEST(ReplayChunks, SendsWhatWasSentAndKeepsTheStatesOfThisPlay) {
  FakeRobot robot;
  const auto played = ReplayChunks(Recorded(), /*initial_state=*/3, robot);
  ASSERT_TRUE(played.ok()) << played.status();
  EXPECT_EQ(robot.resets, 1);
  ASSERT_EQ(robot.commands.size(), 3u);
  EXPECT_FLOAT_EQ(robot.commands[2][0], 0.6f);
  EXPECT_FLOAT_EQ((*played)[1].steps[0].policy_command[0], 0.3f) << "the commands are kept";
  // Starts at 0.01 m per initial state and follows 0.3 of 0.05 m per unit.
  const auto x = [](const RobotState& state) { return state.tool.p_base_tool.x(); };
  EXPECT_NEAR(x((*played)[0].steps[0].before), 0.03, 1e-9);
  EXPECT_NEAR(x((*played)[0].steps[1].before), 0.03 + 0.015 * 0.2, 1e-9);
  EXPECT_NEAR(x((*played)[0].final_state), 0.03 + 0.015 * 0.6, 1e-9);
  EXPECT_NEAR(x((*played)[1].steps[0].before), 0.03 + 0.015 * 0.6, 1e-9);
  EXPECT_NEAR(x((*played)[1].final_state), 0.03 + 0.015 * 1.2, 1e-9);
}

TEST(ReplayChunks, PlaysOnAfterSuccess) {
  FakeRobot robot(/*goal=*/1e-6);
  ASSERT_TRUE(ReplayChunks(Recorded(), 0, robot).ok());
  EXPECT_TRUE(robot.Success());
  EXPECT_EQ(robot.commands.size(), 3u);
}

TEST(ReplayChunks, PassesOnWhatTheRobotReports) {
  FakeRobot robot;
  robot.steps_to_failure = 1;
  EXPECT_THAT(std::string(ReplayChunks(Recorded(), 0, robot).status().message()),
              HasSubstr("tripped"));
}

}  // namespace
}  // namespace robostress
