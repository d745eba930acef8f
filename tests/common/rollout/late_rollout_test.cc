#include "common/rollout/late_rollout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/common/rollout/fake_robot.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr int kRows = 20, kExecuted = 4;

// Rows say where they come from: x is chunk + row / 100 before the correction and 0.5 more as sent,
// the gripper row / 1000.
class NumberedPolicy : public PolicyEndpoint {
 public:
  NumberedPolicy() {
    spec_.name = "numbered";
    spec_.state_dim = 2;
    spec_.horizon = kRows;
    spec_.execute_steps = kExecuted;
    spec_.inpaints = true;
  }
  const PolicySpec& spec() const override { return spec_; }
  PolicySpec& spec() { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override {
    return Answer(observation, chunk, std::nullopt);
  }
  absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                              const RunningRows& running) override {
    return Answer(observation, chunk, running);
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    feedback.push_back(std::move(executed));
    return absl::OkStatus();
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

  const FakeRobot* robot = nullptr;
  int rows = kRows;
  std::vector<int> asked_at, known;  // control steps; feedback that was in
  std::vector<std::optional<RunningRows>> running;
  std::vector<ExecutedChunk> feedback;

 private:
  absl::StatusOr<PredictedChunk> Answer(const Observation&, int chunk,
                                        std::optional<RunningRows> after) {
    asked_at.push_back(static_cast<int>(robot->commands.size()));
    known.push_back(static_cast<int>(feedback.size()));
    running.push_back(std::move(after));
    PredictedChunk answer;
    answer.prediction_id = 100 + static_cast<uint64_t>(chunk);
    answer.policy_actions = Eigen::MatrixXf::Zero(rows, 7);
    for (int i = 0; i < rows; ++i) {
      answer.policy_actions(i, 0) = static_cast<float>(chunk) + static_cast<float>(i) / 100;
      answer.policy_actions(i, 6) = static_cast<float>(i) / 1000;
    }
    answer.base_actions = answer.policy_actions;
    answer.actions = answer.policy_actions;
    answer.actions.col(0).array() += 0.5f;
    return answer;
  }
  PolicySpec spec_;
};

class LateRolloutTest : public testing::Test {
 protected:
  void Play(LateChunks mode, int delay, int steps) {
    robot = std::make_unique<FakeRobot>(1e9, steps);
    policy.robot = robot.get();
    RolloutOptions options;
    options.late.mode = mode;
    options.late.delay_steps = delay;
    options.late.fade_steps = fade_steps;
    options.late.guide_rows = guide_rows;
    const absl::StatusOr<EpisodeRecord> played =
        RunEpisode({2, 5}, options, *robot, policy, sequence);
    ASSERT_TRUE(played.ok()) << played.status();
    record = *played;
  }
  // x of each command as chunk * 100 + row; -1: the arm held.
  std::vector<int> Rows() const {
    std::vector<int> rows;
    for (const Eigen::VectorXf& command : robot->commands)
      rows.push_back(command[0] == 0 ? -1
                                     : static_cast<int>(std::lround(100 * (command[0] - 0.5))));
    return rows;
  }
  NumberedPolicy policy;
  std::unique_ptr<FakeRobot> robot;
  EpisodeRecord record;
  uint64_t sequence = 10;
  int fade_steps = 4, guide_rows = 0;
};

TEST_F(LateRolloutTest, WaitingHoldsUntilEachAnswerIsThereAndPlaysItFromItsFirstRow) {
  Play(LateChunks::kWaiting, 3, 17);
  EXPECT_THAT(Rows(),
              ElementsAre(-1, -1, -1, 0, 1, 2, 3, -1, -1, -1, 100, 101, 102, 103, -1, -1, -1));
  EXPECT_THAT(policy.asked_at, ElementsAre(0, 7, 14));
  EXPECT_EQ(robot->observations, 3);
  EXPECT_EQ(robot->commands[0][6], -1) << "an open gripper before the first command";
  EXPECT_EQ(robot->commands[8][6], 3 / 1000.0f) << "as it was commanded last";
}

TEST_F(LateRolloutTest, SwitchPlaysOnAndEntersAtTheRowThatIsDue) {
  Play(LateChunks::kSwitch, 3, 18);
  EXPECT_THAT(Rows(),
              ElementsAre(-1, -1, -1, 0, 1, 2, 3, 4, 5, 6, 103, 104, 105, 106, 203, 204, 205, 206));
  EXPECT_THAT(policy.asked_at, ElementsAre(0, 7, 11, 15));
}

TEST_F(LateRolloutTest, AnAnswerThatTakesLongerThanAChunkIsAskedForOneAtATime) {
  Play(LateChunks::kSwitch, 6, 24);
  EXPECT_THAT(policy.asked_at, ElementsAre(0, 10, 16, 22));
  EXPECT_THAT(Rows(), ElementsAre(-1, -1, -1, -1, -1, -1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 106, 107,
                                  108, 109, 110, 111, 206, 207));
}

TEST_F(LateRolloutTest, WithoutRowsTheArmHoldsAndNoRowFallsDue) {
  policy.rows = 5;
  Play(LateChunks::kSwitch, 3, 14);
  EXPECT_THAT(policy.asked_at, ElementsAre(0, 7, 13));
  // One more row was left at step 7; two holds.
  EXPECT_THAT(Rows(), ElementsAre(-1, -1, -1, 0, 1, 2, 3, 4, -1, -1, 101, 102, 103, 104));
}

TEST_F(LateRolloutTest, ReportsBelongToTheChunkThatCommandedTheirRows) {
  Play(LateChunks::kSwitch, 3, 18);
  ASSERT_EQ(policy.feedback.size(), 3u);
  const std::pair<int, size_t> rows[] = {{0, 7}, {3, 4}, {3, 4}};
  for (int k = 0; k < 3; ++k) {
    const ExecutedChunk& chunk = policy.feedback[k];
    EXPECT_EQ(chunk.sequence, 11u + k);
    EXPECT_EQ(chunk.task, 2);
    EXPECT_EQ(chunk.episode, 5);
    EXPECT_EQ(chunk.chunk, k);
    EXPECT_EQ(chunk.prediction_id, 100u + k);
    EXPECT_EQ(chunk.first_step, rows[k].first);
    ASSERT_EQ(chunk.steps.size(), rows[k].second);
    EXPECT_TRUE(chunk.masked.empty());
    EXPECT_EQ(chunk.last_of_episode, k == 2);
    for (size_t i = 0; i < chunk.steps.size(); ++i) {
      const ExecutedStep& step = chunk.steps[i];
      const RobotState& after =
          i + 1 < chunk.steps.size() ? chunk.steps[i + 1].before : chunk.final_state;
      EXPECT_FLOAT_EQ(step.policy_command[0],
                      k + static_cast<float>(chunk.first_step + static_cast<int>(i)) / 100);
      EXPECT_EQ(step.base_command, step.policy_command);
      EXPECT_FLOAT_EQ(step.sent_command[0], step.policy_command[0] + 0.5f);
      EXPECT_NEAR(after.tool.p_base_tool.x() - step.before.tool.p_base_tool.x(),
                  0.015 * step.sent_command[0], 1e-6);
    }
  }
  EXPECT_THAT(policy.known, ElementsAre(0, 0, 1, 2)) << "before the arm left the chunk that played";
  EXPECT_EQ(sequence, 13u);
  EXPECT_EQ(record.chunks.size(), 3u);
  EXPECT_EQ(record.steps, 18);
}

TEST_F(LateRolloutTest, HoldsAreRowsThatTheClientReplaced) {
  Play(LateChunks::kWaiting, 2, 14);
  ASSERT_EQ(policy.feedback.size(), 2u);
  const ExecutedChunk& chunk = policy.feedback[0];
  ASSERT_EQ(chunk.steps.size(), 6u);
  EXPECT_THAT(chunk.masked, ElementsAre(false, false, false, false, true, true));
  for (const size_t i : {4u, 5u}) {
    const ExecutedStep& step = chunk.steps[i];
    EXPECT_TRUE((step.sent_command.head(6).array() == 0).all());
    EXPECT_EQ(step.policy_command, step.sent_command);
    EXPECT_EQ(step.base_command, step.sent_command);
  }
  EXPECT_EQ(chunk.final_state.stamp_s, policy.feedback[1].steps[0].before.stamp_s)
      << "reports follow each other without a gap";
}

TEST_F(LateRolloutTest, AReportHasNoMoreRowsThanItsChunk) {
  policy.rows = 5;
  Play(LateChunks::kWaiting, 3, 16);
  ASSERT_EQ(policy.feedback.size(), 2u);
  EXPECT_EQ(policy.feedback[0].steps.size(), 5u);
  EXPECT_NEAR(policy.feedback[0].final_state.stamp_s, 0.05 * 8, 1e-12);
  EXPECT_EQ(policy.feedback[1].steps.size(), 5u);
}

TEST_F(LateRolloutTest, CrossfadeTakesTheOffsetOverAndFadesItOutLinearly) {
  Play(LateChunks::kCrossfade, 2, 12);
  // 0..5, then chunk 1 from row 2: the offset -0.96 + ... at 4/5, 3/5, 2/5, 1/5 of it.
  ASSERT_EQ(robot->commands.size(), 12u);
  const float offset = (0.06f) - (1.02f);
  for (int i = 0; i < 4; ++i) {
    const float own = 1.02f + static_cast<float>(i) / 100 + 0.5f;
    const float share = static_cast<float>(4 - i) / 5;
    EXPECT_NEAR(robot->commands[8 + i][0], own + share * offset, 1e-5) << i;
    EXPECT_FLOAT_EQ(robot->commands[8 + i][6], static_cast<float>(2 + i) / 1000)
        << "the gripper switches at once";
  }
  ASSERT_EQ(policy.feedback.size(), 2u);
  const ExecutedChunk& faded = policy.feedback[1];
  ASSERT_EQ(faded.steps.size(), 4u);
  EXPECT_THAT(faded.masked, ElementsAre(true, true, true, true));
  EXPECT_NEAR(faded.steps[0].policy_command[0], 1.02f + 0.8f * offset, 1e-5)
      << "what both chunks asked for";
}

TEST_F(LateRolloutTest, AFadeOfNothingIsNotMasked) {
  fade_steps = 0;
  Play(LateChunks::kCrossfade, 2, 12);
  EXPECT_TRUE(policy.feedback[1].masked.empty());
}

TEST_F(LateRolloutTest, RtcTellsWhatIsLeftAndHowMuchOfItIsHeld) {
  Play(LateChunks::kRtc, 3, 18);
  ASSERT_EQ(policy.running.size(), 4u);
  EXPECT_FALSE(policy.running[0]) << "nothing runs";
  ASSERT_TRUE(policy.running[1]);
  EXPECT_EQ(policy.running[1]->held, 3);
  ASSERT_EQ(policy.running[1]->actions.rows(), kRows - 4);
  EXPECT_FLOAT_EQ(policy.running[1]->actions(0, 0), 0.04f) << "the policy's own, uncorrected";
  ASSERT_TRUE(policy.running[2]);
  EXPECT_FLOAT_EQ(policy.running[2]->actions(0, 0), 1.04f)
      << "row 4 of chunk 1 is due at the observation of chunk 2";
  EXPECT_EQ(policy.running[2]->actions.rows(), kRows - 4);
  // What was held is what was played.
  for (int i = 0; i < 3; ++i) {
    EXPECT_FLOAT_EQ(robot->commands[11 + i][0], policy.running[2]->actions(i, 0) + 0.5f) << i;
  }
}

TEST_F(LateRolloutTest, RtcSendsOnlyTheRowsThatAreToGuide) {
  guide_rows = 2;
  Play(LateChunks::kRtc, 3, 18);
  EXPECT_EQ(policy.running[1]->held, 3);
  EXPECT_EQ(policy.running[1]->actions.rows(), 5);
}

TEST_F(LateRolloutTest, OtherModesAskForChunksOfTheirOwn) {
  Play(LateChunks::kCrossfade, 3, 18);
  for (const auto& running : policy.running) EXPECT_FALSE(running);
}

TEST_F(LateRolloutTest, WithoutDelayNothingIsLateWhateverTheMode) {
  Play(LateChunks::kWaiting, 0, 8);
  EXPECT_THAT(Rows(), ElementsAre(0, 1, 2, 3, 100, 101, 102, 103));
}

TEST_F(LateRolloutTest, RefusesJointTargets) {
  policy.spec().control_space = ControlSpace::kJoint;
  FakeRobot arm;
  policy.robot = &arm;
  RolloutOptions options;
  options.late.delay_steps = 1;
  const absl::Status status = RunEpisode({0, 0}, options, arm, policy, sequence).status();
  EXPECT_TRUE(absl::IsInvalidArgument(status));
  EXPECT_THAT(std::string(status.message()), HasSubstr("client.latency_ticks"));
}

TEST(LatePlayTest, AnAnswerIsThereAtTheFirstStepThatIsNotBeforeIt) {
  const auto steps = [](int ms, double period) {
    LatencyOptions options;
    options.ms = ms;
    return LatePlayOf(options, period).delay_steps;
  };
  EXPECT_EQ(steps(0, 0.05), 0);
  EXPECT_EQ(steps(1, 0.05), 1);
  EXPECT_EQ(steps(50, 0.05), 1);
  EXPECT_EQ(steps(51, 0.05), 2);
  EXPECT_EQ(steps(150, 0.05), 3);
  EXPECT_EQ(steps(300, 0.05), 6);
  EXPECT_EQ(steps(100, 1.0 / 30), 3);
}

TEST(InpaintingTest, APolicyThatCannotSaysWhatToTake) {
  struct Plain : NumberedPolicy {
    absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                                const RunningRows& running) override {
      // NOLINTNEXTLINE(bugprone-parent-virtual-call): a policy that has none of its own
      return PolicyEndpoint::PredictAfter(observation, chunk, running);
    }
  } plain;
  const absl::Status status = plain.PredictAfter({}, 0, {}).status();
  EXPECT_TRUE(absl::IsUnimplemented(status));
  EXPECT_THAT(std::string(status.message()), HasSubstr("take waiting, switch or crossfade"));
}

}  // namespace
}  // namespace robostress
