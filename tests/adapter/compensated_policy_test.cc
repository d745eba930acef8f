#include "adapter/compensated_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// Says the same chunk whatever it sees.
class SameChunk : public PolicyEndpoint {
 public:
  SameChunk() {
    spec_.name = "same";
    spec_.horizon = 10;
    spec_.execute_steps = 5;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    PredictedChunk chunk = ConstantPrediction(0.4f * Eigen::VectorXf::Unit(7, 0), 10);
    chunk.prediction_id = ++predictions_;
    return chunk;
  }
  absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                              const RunningRows& running) override {
    if (!goes_on) return PolicyEndpoint::PredictAfter(observation, chunk, running);
    running_rows = static_cast<int>(running.actions.rows());
    return Predict(observation, chunk);
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    ++reported;
    told = std::move(executed);
    return absl::OkStatus();
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats(); }
  int reported = 0, running_rows = 0;
  bool goes_on = false;
  ExecutedChunk told;  // the last

 private:
  PolicySpec spec_;
  uint64_t predictions_ = 0;
};

class CompensatedPolicyTest : public ::testing::Test {
 protected:
  void Wrap(const std::string& method) {
    auto made = CompensatedPolicy::Create(&inner_, {}, *MakeMethod(method));
    ASSERT_TRUE(made.ok()) << made.status();
    policy_ = *std::move(made);
    ASSERT_TRUE(policy_->StartEpisode({0, 0}).ok());
  }
  PredictedChunk Predict(int chunk) { return *policy_->Predict({}, chunk); }
  // Of an arm that goes a tenth as far as it is told, a third of what the controller reaches.
  ExecutedChunk Short(const PredictedChunk& predicted, uint64_t sequence) {
    ExecutedChunk executed = ToyArm(0.1).Execute(predicted, 5);
    executed.sequence = sequence;
    return executed;
  }

  SameChunk inner_;
  std::unique_ptr<CompensatedPolicy> policy_;
};

TEST_F(CompensatedPolicyTest, BaseChangesNothing) {
  Wrap("base");
  for (int chunk = 0; chunk < 4; ++chunk) {
    const PredictedChunk predicted = Predict(chunk);
    EXPECT_EQ(predicted.actions, predicted.policy_actions);
    ASSERT_TRUE(policy_->SendFeedback(Short(predicted, chunk + 1)).ok());
  }
  EXPECT_EQ(inner_.reported, 4);
}

TEST_F(CompensatedPolicyTest, AnArmThatFallsShortIsToldMore) {
  Wrap("ours_following");
  EXPECT_EQ(Predict(0).actions(0, 0), 0.4f);
  for (int chunk = 0; chunk < 4; ++chunk)
    ASSERT_TRUE(policy_->SendFeedback(Short(Predict(chunk), chunk + 1)).ok());
  const PredictedChunk told = Predict(4);
  EXPECT_GT(told.actions(0, 0), 0.45f);
  EXPECT_EQ(told.policy_actions(0, 0), 0.4f) << "the policy's own is not touched";
  EXPECT_EQ(told.actions.col(6), told.policy_actions.col(6)) << "nor the gripper";
}

TEST_F(CompensatedPolicyTest, APolicyThatLearnsIsToldTheCommandsBeforeSmoothing) {
  for (const bool learns : {false, true}) {
    MethodOptions method =
        *MakeMethod("ours_following_smooth", {"integral_rate=0", "following_threshold=0"});
    if (learns) method.target = TargetReference::kSent;
    policy_ = *CompensatedPolicy::Create(&inner_, {}, method);
    ASSERT_TRUE(policy_->StartEpisode({0, 0}).ok());
    const PredictedChunk predicted = Predict(0);
    ExecutedChunk so_far;
    so_far.prediction_id = predicted.prediction_id;
    std::vector<float> sent;
    ToyArm arm(0.1);
    for (int row = 0; row < 5; ++row) {
      PredictedChunk due = predicted;
      const auto command = policy_->NextCommand(predicted, so_far);
      ASSERT_TRUE(command.ok()) << command.status();
      due.actions.row(row) = command->transpose();
      const ExecutedChunk step = arm.Execute(due, 1, row);
      so_far.steps.push_back(step.steps[0]);
      so_far.final_state = step.final_state;
      sent.push_back((*command)[0]);
    }
    so_far.sequence = learns ? 2 : 1;
    ASSERT_TRUE(policy_->SendFeedback(so_far).ok());
    ASSERT_EQ(inner_.told.steps.size(), 5u);
    EXPECT_NEAR(sent[0], 0.6f * 0.4f, 1e-6f);
    for (int row = 0; row < 5; ++row) {
      const float told = inner_.told.steps[row].sent_command[0];
      if (learns) {
        // c = s c_before + (1 - s) told
        EXPECT_NEAR(sent[row], 0.4f * (row == 0 ? 0 : sent[row - 1]) + 0.6f * told, 1e-6f) << row;
      } else {
        EXPECT_EQ(told, sent[row]) << row;
      }
    }
    if (learns) {
      EXPECT_EQ(inner_.told.steps[0].sent_command[0], 0.4f);
      EXPECT_GT(inner_.told.steps[4].sent_command[0], 0.41f) << "it falls short";
    }
  }
}

TEST_F(CompensatedPolicyTest, ANewEpisodeForgetsTheDirectCorrection) {
  Wrap("direct");
  ASSERT_TRUE(policy_->SendFeedback(Short(Predict(0), 1)).ok());
  EXPECT_GT(Predict(1).actions(0, 0), 0.45f);
  ASSERT_TRUE(policy_->StartEpisode({0, 1}).ok());
  EXPECT_EQ(Predict(0).actions(0, 0), 0.4f);
}

TEST_F(CompensatedPolicyTest, AChunkThatComesTwiceTeachesOnce) {
  Wrap("ours_following");
  const ExecutedChunk once = Short(Predict(0), 1);
  ASSERT_TRUE(policy_->SendFeedback(once).ok());
  const Eigen::MatrixXf told = Predict(1).actions;
  ASSERT_TRUE(policy_->SendFeedback(once).ok());
  EXPECT_EQ(Predict(1).actions, told);
  EXPECT_NE(told(0, 0), 0.4f);
}

TEST_F(CompensatedPolicyTest, AnotherEpisodesChunkTeachesNothing) {
  Wrap("ours_following");
  for (int chunk = 0; chunk < 4; ++chunk) {
    ExecutedChunk executed = Short(Predict(chunk), chunk + 1);
    executed.episode = 7;
    ASSERT_TRUE(policy_->SendFeedback(executed).ok());
  }
  EXPECT_EQ(Predict(4).actions(0, 0), 0.4f);
}

TEST_F(CompensatedPolicyTest, RefusesWhatNobodyCanHaveMeasuredAndStaysAsItWas) {
  Wrap("ours_following");
  ExecutedChunk executed = Short(Predict(0), 1);
  executed.final_state.tool.p_base_tool.x() = std::nan("");
  EXPECT_FALSE(policy_->SendFeedback(executed).ok());
  EXPECT_EQ(inner_.reported, 0);
  EXPECT_EQ(Predict(1).actions(0, 0), 0.4f);
}

TEST_F(CompensatedPolicyTest, TellsWhichMethodNeedsWeights) {
  const auto made = CompensatedPolicy::Create(&inner_, {.policy = "pi05"}, *MakeMethod("ours"));
  EXPECT_THAT(
      made.status().message(),
      HasSubstr("method 'ours' trains an adapter in the policy's weights (LoRA), and policy "
                "'pi05'"));
}

TEST_F(CompensatedPolicyTest, RefusesAMethodThatNeedsAModelOfTheArm) {
  const auto made = CompensatedPolicy::Create(&inner_, {}, *MakeMethod("known_errors"));
  EXPECT_EQ(made.status().code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(made.status().message(), HasSubstr("arm_model=truth"));
}

// -------------------------------------------------------------------------------------- every step

class EveryStepTest : public CompensatedPolicyTest {
 protected:
  // Chunks of `rows` steps as RunEpisode plays them, on an arm that goes a tenth as far as it is
  // told; [chunks * rows, 7] what was sent.
  Eigen::MatrixXf Play(int chunks, int rows) {
    ToyArm arm(0.1);
    Eigen::MatrixXf sent(chunks * rows, 7);
    for (int chunk = 0; chunk < chunks; ++chunk) {
      const PredictedChunk predicted = Predict(chunk);
      ExecutedChunk executed;
      executed.sequence = static_cast<uint64_t>(chunk) + 1;
      executed.chunk = chunk;
      executed.prediction_id = predicted.prediction_id;
      executed.final_state = arm.state();
      for (int row = 0; row < rows; ++row) {
        const auto command = policy_->NextCommand(predicted, executed);
        EXPECT_TRUE(command.ok()) << command.status();
        ExecutedStep step;
        step.before = arm.state();
        step.policy_command = predicted.policy_actions.row(row);
        step.sent_command = *command;
        arm.Step(*command);
        executed.steps.push_back(step);
        executed.final_state = arm.state();
        sent.row(chunk * rows + row) = command->transpose();
      }
      EXPECT_TRUE(policy_->SendFeedback(executed).ok());
    }
    return sent;
  }
};

TEST_F(EveryStepTest, IsWhatChunksOfOneStepAre) {
  Wrap("ours_following");
  const Eigen::MatrixXf single = Play(20, 1);
  Wrap("ours_following_step");
  EXPECT_EQ(Play(20, 1), single) << "a chunk of one step has nothing to correct within";
  Wrap("ours_following_step");
  EXPECT_EQ(Play(4, 5), single) << "nor does it matter where a chunk of the same policy begins";
}

TEST_F(EveryStepTest, CorrectsWithinAChunkWhatAChunkCorrectsInTheNext) {
  Wrap("ours_following");
  const Eigen::MatrixXf late = Play(3, 5);
  Wrap("ours_following_step");
  const Eigen::MatrixXf soon = Play(3, 5);
  EXPECT_GT(late(5, 0), 0.4f);
  EXPECT_EQ(late.col(0).segment(5, 5), Eigen::VectorXf::Constant(5, late(5, 0)));
  EXPECT_EQ(soon(5, 0), late(5, 0)) << "the first chunk was the same below the threshold";
  for (int step = 5; step < 9; ++step) EXPECT_GT(soon(step + 1, 0), soon(step, 0)) << step;
  EXPECT_EQ(soon.col(6), late.col(6)) << "the gripper is the policy's";
}

TEST_F(EveryStepTest, SmoothsAcrossChunksAndFromRestInEveryEpisode) {
  Wrap("smooth");
  const Eigen::MatrixXf policy = Predict(0).policy_actions;
  for (int episode = 0; episode < 2; ++episode) {
    ASSERT_TRUE(policy_->StartEpisode({0, episode}).ok());
    const Eigen::MatrixXf sent = Play(2, 2);
    float command = 0;
    for (int step = 0; step < 4; ++step) {
      command = 0.4f * command + 0.6f * policy(0, 0);
      EXPECT_NEAR(sent(step, 0), command, 1e-6f) << step;
    }
    EXPECT_EQ(sent.col(6), Eigen::VectorXf::Constant(4, policy(0, 6))) << "the gripper's";
  }
}

TEST_F(EveryStepTest, AnImpossibleMeasurementCorrectsNothing) {
  Wrap("ours_following_step");
  const PredictedChunk predicted = Predict(0);
  ExecutedChunk executed = Short(predicted, 1);
  executed.steps.resize(1);
  executed.final_state = executed.steps[0].before;
  executed.final_state.tool.p_base_tool.x() = -9;  // [m] in a control step
  EXPECT_EQ((*policy_->NextCommand(predicted, executed))[0], 0.4f);
}

TEST_F(CompensatedPolicyTest, CorrectsAChunkThatGoesOnFromARunningOneAsAnyOther) {
  Wrap("gain");
  RunningRows running;
  running.actions = Eigen::MatrixXf::Ones(3, 7);
  EXPECT_TRUE(absl::IsUnimplemented(policy_->PredictAfter({}, 0, running).status()));
  inner_.goes_on = true;
  const absl::StatusOr<PredictedChunk> predicted = policy_->PredictAfter({}, 0, running);
  ASSERT_TRUE(predicted.ok()) << predicted.status();
  EXPECT_EQ(inner_.running_rows, 3);
  EXPECT_EQ(predicted->actions, Predict(1).actions);
  EXPECT_NE(predicted->actions, predicted->policy_actions);
}

}  // namespace
}  // namespace robostress
