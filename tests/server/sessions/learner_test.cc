// The learner alone: no threads, no session around it.
#include "server/sessions/learner.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <limits>

#include "server/sessions/state_rules.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class LearnerTest : public ::testing::Test {
 protected:
  std::unique_ptr<Learner> Make(const std::string& method,
                                const std::vector<std::string>& overrides = {},
                                const GuardOptions& guard = {}) {
    specs_.push_back(std::make_unique<SessionSpec>(Spec(method, overrides)));
    auto learner = Learner::Create(specs_.back().get(), policy_, prefixes_, guard);
    EXPECT_TRUE(learner.ok()) << learner.status();
    return *std::move(learner);
  }
  // One chunk of an episode, predicted as a session does and executed by an arm of gain 0.6.
  std::optional<Learner::Update> Teach(Learner& learner, uint64_t sequence) {
    const auto observation = Shared(FakePolicy::MakeObservation(static_cast<int>(sequence)));
    Prediction prediction{.id = sequence, .key = {{0, 0}, static_cast<int>(sequence)}};
    PolicyContext context = *policy_->Encode(*observation);
    prediction.raw = policy_->Sample(context, torch::ones({1, 10, 8}), nullptr).squeeze(0);
    prediction.state = context.state;
    prediction.observation = observation;
    prediction.prefix = prefixes_->Add(policy_, observation, std::move(context));
    PredictedChunk answer;
    answer.actions = answer.policy_actions =
        policy_->ToEnvironment(prediction.raw, prediction.state);
    ExecutedChunk executed = arm_.Execute(answer, 5);
    executed.sequence = sequence;
    executed.chunk = prediction.key.chunk;
    const auto measured = MeasuredChunk::Create(executed, policy_->spec(), {});
    EXPECT_TRUE(measured.ok()) << measured.status();
    auto lesson = learner.Prepare(*measured, prediction);
    EXPECT_TRUE(lesson.ok()) << lesson.status();
    return learner.Learn(*std::move(lesson), sequence);
  }

  std::shared_ptr<const FlowPolicy> policy_ = std::make_shared<FakePolicy>();
  std::shared_ptr<PrefixStore> prefixes_ = std::make_shared<PrefixStore>();
  std::vector<std::unique_ptr<SessionSpec>> specs_;
  ToyArm arm_{0.6};
};

TEST_F(LearnerTest, AnUpdateFallsDueAsScheduledAndIsPublishedWhenItIsComputed) {
  const auto learner = Make("ours", {kRate, "buffer_chunks=4", "update_interval=2", "batch=2"});
  for (uint64_t sequence = 1; sequence <= 3; ++sequence)
    EXPECT_FALSE(Teach(*learner, sequence).has_value());
  const auto update = Teach(*learner, 4);
  ASSERT_TRUE(update.has_value());
  EXPECT_EQ(update->index, 0u);
  EXPECT_EQ(update->sequence, 4u);
  EXPECT_EQ(update->batch.size(), 2u);
  EXPECT_TRUE(update->held_out.empty());
  EXPECT_EQ(learner->pending(), 1);
  EXPECT_EQ(learner->updates_applied(), 0u) << "nothing is learned until it is computed";
  EXPECT_TRUE(learner->Finish(*update, learner->Compute(*update)).ok());
  EXPECT_EQ(learner->pending(), 0);
  EXPECT_EQ(learner->updates_applied(), 1u);
  EXPECT_GT(learner->distance(), 0);
  EXPECT_GT(learner->last_loss(), 0);
  EXPECT_FALSE(Teach(*learner, 5).has_value());
  const auto next = Teach(*learner, 6);
  ASSERT_TRUE(next.has_value());
  EXPECT_EQ(next->index, 1u);
}

TEST_F(LearnerTest, PreparingChangesNothing) {
  const auto learner = Make("ours_nominal", {kRate, "buffer_chunks=4", "batch=2"});
  Teach(*learner, 1);
  const AdaptationState before = learner->State();
  ExecutedChunk executed = arm_.Execute(ConstantPrediction(Eigen::VectorXf::Ones(7), 10), 5);
  executed.sequence = 2;
  executed.chunk = 2;
  const auto measured = MeasuredChunk::Create(executed, policy_->spec(), {});
  Prediction prediction{.id = 2, .key = {{0, 0}, 2}};
  prediction.raw = torch::zeros({10, 8});
  prediction.state = torch::zeros({1, 3});
  ASSERT_TRUE(learner->Prepare(*measured, prediction).ok());
  const AdaptationState after = learner->State();
  EXPECT_EQ(after.nominal.goal, before.nominal.goal);
  EXPECT_EQ(after.chunks_since_clear, 1);
  EXPECT_EQ(learner->buffered(), 1);
}

TEST_F(LearnerTest, ABoundaryClearsTheBufferWhenItsFeedbackIsIn) {
  const auto learner = Make("ours", {"buffer_chunks=4", "update_interval=2", "batch=2"});
  Teach(*learner, 1);
  Teach(*learner, 2);
  learner->AddBoundary(3, 2);
  EXPECT_EQ(learner->buffered(), 2) << "feedback 3 is still under way";
  Teach(*learner, 3);
  EXPECT_EQ(learner->buffered(), 0);
  EXPECT_TRUE(learner->boundaries().empty());
  Teach(*learner, 4);
  learner->AddBoundary(4, 4);
  EXPECT_EQ(learner->buffered(), 0) << "it is in";
}

TEST_F(LearnerTest, BoundariesThatWaitAreBounded) {
  const auto learner = Make("base");
  for (uint64_t i = 1; i <= StateRules::kMaxBoundaries; ++i) learner->AddBoundary(i, 0);
  EXPECT_THAT(std::string(learner->CheckBoundary(5000, 0).message()),
              HasSubstr("the last feedback of 1024 tasks is still missing"));
  EXPECT_TRUE(learner->CheckBoundary(7, 7).ok());
}

TEST_F(LearnerTest, OutcomesAreCountedAndAnErrorIsHandedOn) {
  GuardOptions guard;
  guard.enabled = true;
  guard.max_distance = 1e-12;
  const auto learner =
      Make("ours", {kRate, "buffer_chunks=4", "update_interval=1", "batch=2"}, guard);
  std::optional<Learner::Update> update;
  for (uint64_t sequence = 1; sequence <= 4; ++sequence) update = Teach(*learner, sequence);
  ASSERT_TRUE(update.has_value());
  EXPECT_EQ(update->held_out.size(), 2u) << "what the batch leaves of four";
  EXPECT_TRUE(learner->Finish(*update, learner->Compute(*update)).ok());
  EXPECT_EQ(learner->counters().guarded, 1u);
  EXPECT_EQ(learner->updates_applied(), 0u);
  update = Teach(*learner, 5);
  EXPECT_EQ(learner->Finish(*update, absl::InternalError("out of memory")).message(),
            "out of memory");
  UpdateReport refused;
  refused.loss = std::numeric_limits<double>::infinity();
  const double loss = learner->last_loss();
  update = Teach(*learner, 6);
  EXPECT_TRUE(learner->Finish(*update, refused).ok());
  EXPECT_EQ(learner->counters().refused, 1u);
  EXPECT_EQ(learner->last_loss(), loss);
}

TEST_F(LearnerTest, AMethodThatDoesNotAdaptHasNothingToLearn) {
  const auto learner = Make("base");
  EXPECT_FALSE(learner->adapts());
  EXPECT_FALSE(Teach(*learner, 1).has_value());
  EXPECT_EQ(learner->buffered(), 0);
  EXPECT_EQ(learner->updates_applied(), 0u);
  EXPECT_EQ(learner->RequireAdapter("export").code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(learner->Versions().empty());
}

}  // namespace
}  // namespace robostress
