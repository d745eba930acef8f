#include "common/rollout/rollout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/common/rollout/fake_robot.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// Commands 1 along x; remembers what it is asked and told. Executes 3 of 4.
class FakePolicy : public PolicyEndpoint {
 public:
  FakePolicy() {
    spec_.name = "fake";
    spec_.state_dim = 2;
    spec_.horizon = 4;
    spec_.execute_steps = 3;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey& key) override {
    started.push_back(key.episode);
    resets_at_start = robot->resets;
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int chunk) override {
    chunks.push_back(chunk);
    feedback_at_predict.push_back(static_cast<int>(feedback.size()));
    PredictedChunk prediction;
    prediction.prediction_id = 100 + chunk;
    prediction.policy_actions = Eigen::MatrixXf::Zero(rows, 7);
    prediction.policy_actions.col(0).setLinSpaced(1, 1.3f);
    prediction.actions = 2 * prediction.policy_actions;
    if (with_base) prediction.base_actions = -prediction.policy_actions;
    return prediction;
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    feedback.push_back(std::move(executed));
    return feedback_status;
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

  const FakeRobot* robot = nullptr;
  int rows = 4, resets_at_start = 0;
  bool with_base = true;
  absl::Status feedback_status;
  std::vector<int> started, chunks, feedback_at_predict;
  std::vector<ExecutedChunk> feedback;

 private:
  PolicySpec spec_;
};

struct RolloutTest : public testing::Test {
  absl::StatusOr<EpisodeRecord> Run(FakeRobot& robot, const RolloutOptions& options = {}) {
    policy.robot = &robot;
    return RunEpisode({2, 5}, options, robot, policy, sequence);
  }
  FakePolicy policy;
  uint64_t sequence = 10;
};

TEST_F(RolloutTest, ObservesOncePerChunkAndExecutesItsFirstSteps) {
  FakeRobot robot(1e9, 7);
  const absl::StatusOr<EpisodeRecord> record = Run(robot);
  ASSERT_TRUE(record.ok()) << record.status();
  EXPECT_FALSE(record->success);
  EXPECT_EQ(record->steps, 7);
  EXPECT_EQ(robot.observations, 3);
  EXPECT_THAT(policy.chunks, ElementsAre(0, 1, 2));
  EXPECT_THAT(policy.feedback_at_predict, ElementsAre(0, 1, 2))
      << "feedback precedes the next prediction";
  EXPECT_THAT(policy.started, ElementsAre(5));
  EXPECT_EQ(policy.resets_at_start, 1) << "the robot is reset before the policy's episode starts";
  ASSERT_EQ(robot.commands.size(), 7u);
  EXPECT_FLOAT_EQ(robot.commands[4][0], 2.2f) << "the second row of the second chunk, as corrected";
}

TEST_F(RolloutTest, ExecutesAsManyRowsAsItIsTold) {
  FakeRobot robot(1e9, 7);
  RolloutOptions options;
  options.execute_steps = 2;
  ASSERT_TRUE(Run(robot, options).ok());
  EXPECT_EQ(robot.observations, 4);
  ASSERT_EQ(policy.feedback.size(), 4u);
  EXPECT_EQ(policy.feedback[0].steps.size(), 2u);
  EXPECT_EQ(policy.feedback[3].steps.size(), 1u);
  options.execute_steps = 4;
  EXPECT_TRUE(Run(robot, options).ok());
  options.execute_steps = 5;
  EXPECT_THAT(std::string(Run(robot, options).status().message()),
              HasSubstr("execute_steps is 5, a chunk of policy 'fake' has 4 rows"));
}

TEST_F(RolloutTest, HorizonCutsTheLastChunkShort) {
  FakeRobot robot(1e9, 7);
  const absl::StatusOr<EpisodeRecord> record = Run(robot);
  ASSERT_TRUE(record.ok()) << record.status();
  ASSERT_EQ(policy.feedback.size(), 3u);
  EXPECT_EQ(policy.feedback[0].steps.size(), 3u);
  EXPECT_EQ(policy.feedback[2].steps.size(), 1u);
  EXPECT_FALSE(policy.feedback[1].last_of_episode);
  EXPECT_TRUE(policy.feedback[2].last_of_episode);
}

TEST_F(RolloutTest, SuccessEndsTheEpisodeWithinAChunk) {
  FakeRobot robot(0.1, 100);  // 0.03 m per step and growing: four steps
  const absl::StatusOr<EpisodeRecord> record = Run(robot);
  ASSERT_TRUE(record.ok()) << record.status();
  EXPECT_TRUE(record->success);
  EXPECT_EQ(record->steps, 4);
  ASSERT_EQ(policy.feedback.size(), 2u);
  EXPECT_EQ(policy.feedback[1].steps.size(), 1u);
  EXPECT_TRUE(policy.feedback[1].last_of_episode);
}

TEST_F(RolloutTest, FeedbackCarriesTheStatesAroundEachStepAndAllThreeCommands) {
  FakeRobot robot(1e9, 5);
  ASSERT_TRUE(Run(robot).ok());
  EXPECT_EQ(sequence, 12u);
  ASSERT_EQ(policy.feedback.size(), 2u);
  const ExecutedChunk& chunk = policy.feedback[1];
  EXPECT_EQ(chunk.sequence, 12u);
  EXPECT_EQ(chunk.task, 2);
  EXPECT_EQ(chunk.episode, 5);
  EXPECT_EQ(chunk.chunk, 1);
  EXPECT_EQ(chunk.prediction_id, 101u);
  EXPECT_EQ(chunk.first_step, 0);
  EXPECT_EQ(chunk.steps[0].before.tool.p_base_tool,
            policy.feedback[0].final_state.tool.p_base_tool);
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const RobotState& after =
        i + 1 < chunk.steps.size() ? chunk.steps[i + 1].before : chunk.final_state;
    EXPECT_NEAR(after.tool.p_base_tool.x() - step.before.tool.p_base_tool.x(),
                0.015 * step.sent_command[0], 1e-6);
    EXPECT_NEAR(after.stamp_s - step.before.stamp_s, 0.05, 1e-12);
    EXPECT_EQ(step.sent_command, 2 * step.policy_command);
    EXPECT_EQ(step.base_command, -step.policy_command);
  }
}

TEST_F(RolloutTest, WithoutBaseActionsTheBaseCommandIsEmpty) {
  policy.with_base = false;
  FakeRobot robot;
  ASSERT_TRUE(Run(robot).ok());
  EXPECT_EQ(policy.feedback[0].steps[0].base_command.size(), 0);
}

TEST_F(RolloutTest, AlreadySolvedEpisodeHasNoSteps) {
  FakeRobot robot(0);
  const absl::StatusOr<EpisodeRecord> record = Run(robot);
  ASSERT_TRUE(record.ok()) << record.status();
  EXPECT_TRUE(record->success);
  EXPECT_EQ(record->steps, 0);
  EXPECT_EQ(robot.observations, 0);
  EXPECT_EQ(sequence, 10u);
}

TEST_F(RolloutTest, FilmsTheStartAndEveryStep) {
  std::vector<int> filmed;
  FakeRobot robot(1e9, 4);
  RolloutOptions options;
  options.initial_state = 3;
  options.on_step = [&](int step) { filmed.push_back(step); };
  ASSERT_TRUE(Run(robot, options).ok());
  EXPECT_THAT(filmed, ElementsAre(0, 1, 2, 3, 4));
}

TEST_F(RolloutTest, ErrorsOfRobotAndPolicyEndTheEpisode) {
  FakeRobot robot;
  robot.steps_to_failure = 1;
  EXPECT_THAT(std::string(Run(robot).status().message()), HasSubstr("the arm tripped"));
  policy.feedback_status = absl::UnavailableError("the server is gone");
  FakeRobot sound;
  EXPECT_THAT(std::string(Run(sound).status().message()), HasSubstr("the server is gone"));
}

TEST_F(RolloutTest, PredictionThatIsTooShortIsRefused) {
  policy.rows = 2;
  FakeRobot robot;
  EXPECT_THAT(std::string(Run(robot).status().message()),
              HasSubstr("policy 'fake' predicted 2 x 7 actions, needs at least 3 x 7"));
}

}  // namespace
}  // namespace robostress
