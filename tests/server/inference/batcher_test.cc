#include "server/inference/batcher.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <atomic>
#include <future>

#include "absl/synchronization/mutex.h"
#include "absl/synchronization/notification.h"
#include "common/rollout/refusal.h"
#include "tests/adapter/fake_policy.h"

namespace robostress {
namespace {

// A fake policy whose encoder waits until it is let through, so that a test decides what waits
// meanwhile; it records the sizes of the passes. Observations with an instruction "break" cannot be
// sampled, those with "refuse" cannot be encoded.
class GatedPolicy : public FakePolicy {
 public:
  explicit GatedPolicy(bool exact = true) : exact_(exact) {}
  bool exact_rows() const override { return exact_; }

  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    if (observation.instruction == "hold") {
      ++held;
      gate.WaitForNotification();
    }
    if (observation.instruction == "refuse") return absl::InvalidArgumentError("refused");
    absl::StatusOr<PolicyContext> context = FakePolicy::Encode(observation);
    if (observation.instruction == "break") context->state.fill_(1e6);
    return context;
  }
  torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                       const LoraWeights* lora) const override {
    CheckWhole(context);
    Record(1);
    return FakePolicy::Sample(context, noise, lora);
  }
  torch::Tensor SampleRows(const PolicyContext& context, const torch::Tensor& noise,
                           const std::vector<const LoraWeights*>& lora) const override {
    CheckWhole(context);
    Record(static_cast<int>(lora.size()));
    std::vector<torch::Tensor> rows;
    for (size_t i = 0; i < lora.size(); ++i) {
      const auto row = static_cast<int64_t>(i);
      rows.push_back(
          FakePolicy::Sample(ContextRow(context, row), noise.narrow(0, row, 1), lora[i]));
    }
    return at::cat(rows, 0);
  }
  std::vector<int> passes() const {
    absl::MutexLock lock(&mu_);
    return passes_;
  }

  mutable absl::Notification gate;
  mutable std::atomic<int> held{0};

 private:
  static void CheckWhole(const PolicyContext& context) {
    TORCH_CHECK(context.state.max().item<float>() < 1e5, "broken");
  }
  void Record(int rows) const {
    absl::MutexLock lock(&mu_);
    passes_.push_back(rows);
  }
  const bool exact_;
  mutable absl::Mutex mu_;
  mutable std::vector<int> passes_ ABSL_GUARDED_BY(mu_);
};

LoraWeights SomeAdapter(const FakePolicy& policy, uint64_t version) {
  LoraWeights lora = InitialLora(policy.lora_targets(), LoraKind::kPerMatrix, 2, 0.1,
                                 StreamKey("adapter").With(static_cast<int64_t>(version)));
  for (torch::Tensor& B : lora.B) B = torch::full_like(B, 0.1 * static_cast<double>(version));
  lora.version = version;
  return lora;
}

class BatcherTest : public ::testing::Test {
 protected:
  struct Asked {
    std::shared_ptr<Observation> observation;
    std::future<absl::StatusOr<SampledPrediction>> answer;
  };

  PredictionJob Job(uint64_t session) {
    PredictionJob job;
    job.policy = policy_;
    job.session = session;
    job.noise = FakePolicy::Random(absl::StrCat("noise", session),
                                   {1, FakePolicy::kHorizon, FakePolicy::kDim}, 1);
    return job;
  }
  Asked Ask(Batcher& batcher, PredictionJob job,
            const std::string& instruction = "put the bowl on the plate") {
    auto observation = std::make_shared<Observation>(
        FakePolicy::MakeObservation(static_cast<int>(job.session), instruction));
    Asked asked{observation, {}};
    asked.answer = std::async(std::launch::async, [&batcher, job, observation]() mutable {
      job.observation = observation;
      return batcher.Predict(job);
    });
    return asked;
  }
  // A prediction that keeps the only thread until the gate opens.
  Asked Hold(Batcher& batcher, uint64_t session = 1000) {
    Asked held = Ask(batcher, Job(session), "hold");
    while (policy_->held == 0) std::this_thread::yield();
    return held;
  }
  static void AwaitWaiting(const Batcher& batcher, int count) {
    while (batcher.counters().waiting != count) std::this_thread::yield();
  }
  torch::Tensor Alone(const PredictionJob& job, const LoraWeights* lora) {
    const PolicyContext context =
        *policy_->FakePolicy::Encode(FakePolicy::MakeObservation(static_cast<int>(job.session)));
    return policy_->FakePolicy::Sample(context, job.noise, lora).squeeze(0);
  }
  BatcherOptions OneThread(int max_batch = 8) {
    BatcherOptions options;
    options.threads = 1;
    options.max_batch = max_batch;
    return options;
  }

  std::shared_ptr<GatedPolicy> policy_ = std::make_shared<GatedPolicy>();
};

TEST_F(BatcherTest, WhatWaitsAtTheSameTimeSharesAPassAndEachRowHasTheBitsOfABatchOfOne) {
  Batcher batcher(OneThread());
  Asked held = Hold(batcher);
  std::vector<LoraWeights> adapters;
  for (uint64_t i = 0; i < 5; ++i) adapters.push_back(SomeAdapter(*policy_, i));
  std::vector<Asked> asked;
  for (uint64_t i = 0; i < 5; ++i) {
    PredictionJob job = Job(i);
    job.adapter = [weights = std::make_shared<const LoraWeights>(adapters[i])] { return weights; };
    job.with_base = i == 2;
    asked.push_back(Ask(batcher, job));
  }
  AwaitWaiting(batcher, 5);
  policy_->gate.Notify();
  ASSERT_TRUE(held.answer.get().ok());
  for (uint64_t i = 0; i < 5; ++i) {
    const auto answer = asked[i].answer.get();
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(answer->batch_size, 5);
    EXPECT_EQ(answer->adapter->version, i);
    EXPECT_TRUE(BitEqual(answer->raw, Alone(Job(i), &adapters[i]))) << i;
    ASSERT_EQ(answer->base.defined(), i == 2);
    if (i == 2) {
      EXPECT_TRUE(BitEqual(answer->base, Alone(Job(i), nullptr)));
    }
  }
  EXPECT_THAT(policy_->passes(), ::testing::ElementsAre(1, 6));  // five, one with its base
  EXPECT_EQ(batcher.counters().predictions, 6u);
  EXPECT_EQ(batcher.counters().batches, 2u);
}

// Goes on from a chunk by saying it again.
class Repeats : public GatedPolicy {
 public:
  torch::Tensor Inpaint(const PolicyContext&, const torch::Tensor& noise, const LoraWeights*,
                        const RunningRows& running) const override {
    return torch::full_like(noise, running.actions(0, 0));
  }
};

TEST_F(BatcherTest, AChunkThatGoesOnFromAnotherIsSampledAlone) {
  policy_ = std::make_shared<Repeats>();
  Batcher batcher(OneThread());
  Asked held = Hold(batcher);
  std::vector<Asked> asked;
  for (uint64_t i = 0; i < 3; ++i) {
    PredictionJob job = Job(i);
    job.exact = false;
    if (i == 1) {
      job.running.emplace();
      job.running->actions = Eigen::MatrixXf::Constant(1, 7, 0.25f);
    }
    asked.push_back(Ask(batcher, job));
    AwaitWaiting(batcher, static_cast<int>(i) + 1);
  }
  policy_->gate.Notify();
  for (uint64_t i = 0; i < 3; ++i) {
    const auto answer = asked[i].answer.get();
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(answer->batch_size, i == 1 ? 1 : 2);
    EXPECT_EQ((answer->raw == 0.25).all().item<bool>(), i == 1);
  }
}

TEST_F(BatcherTest, ABatchHoldsNoMoreThanItMay) {
  Batcher batcher(OneThread(2));
  Asked held = Hold(batcher);
  std::vector<Asked> asked;
  for (uint64_t i = 0; i < 3; ++i) asked.push_back(Ask(batcher, Job(i)));
  AwaitWaiting(batcher, 3);
  policy_->gate.Notify();
  for (Asked& a : asked) EXPECT_TRUE(a.answer.get().ok());
  EXPECT_THAT(policy_->passes(), ::testing::ElementsAre(1, 2, 1));
}

TEST_F(BatcherTest, LockstepIsComputedAloneWhereThePolicysRowsAreNotExact) {
  policy_ = std::make_shared<GatedPolicy>(/*exact=*/false);
  Batcher batcher(OneThread());
  Asked held = Hold(batcher);
  std::vector<Asked> asked;
  for (uint64_t i = 0; i < 4; ++i) {
    PredictionJob job = Job(i);
    job.exact = i % 2 == 0;
    asked.push_back(Ask(batcher, job));
    AwaitWaiting(batcher, static_cast<int>(i) + 1);
  }
  policy_->gate.Notify();
  for (uint64_t i = 0; i < 4; ++i) {
    const auto answer = asked[i].answer.get();
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(answer->batch_size, i % 2 == 0 ? 1 : 2);
    if (i % 2 == 0) {
      EXPECT_TRUE(BitEqual(answer->raw, Alone(Job(i), nullptr)));
    }
  }
}

TEST_F(BatcherTest, OnePredictionThatFailsTakesNoOtherDown) {
  Batcher batcher(OneThread());
  Asked held = Hold(batcher);
  Asked broken = Ask(batcher, Job(1), "break"), refused = Ask(batcher, Job(2), "refuse"),
        well = Ask(batcher, Job(3));
  AwaitWaiting(batcher, 3);
  policy_->gate.Notify();
  EXPECT_TRUE(absl::IsInternal(broken.answer.get().status()));
  EXPECT_TRUE(absl::IsInvalidArgument(refused.answer.get().status()));
  const auto answer = well.answer.get();
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_TRUE(BitEqual(answer->raw, Alone(Job(3), nullptr)));
}

TEST_F(BatcherTest, ARealArmIsComputedBeforeSimulationsThatCameEarlier) {
  Batcher batcher(OneThread(1));
  Asked held = Hold(batcher);
  std::atomic<int> order = 0;
  int simulated = 0, robot = 0;
  PredictionJob first = Job(1), second = Job(2);
  first.adapter = [&]() -> std::shared_ptr<const LoraWeights> {
    simulated = ++order;
    return nullptr;
  };
  second.adapter = [&]() -> std::shared_ptr<const LoraWeights> {
    robot = ++order;
    return nullptr;
  };
  second.priority = Priority::kRobot;
  Asked a = Ask(batcher, first);
  AwaitWaiting(batcher, 1);
  Asked b = Ask(batcher, second);
  AwaitWaiting(batcher, 2);
  policy_->gate.Notify();
  EXPECT_TRUE(a.answer.get().ok());
  EXPECT_TRUE(b.answer.get().ok());
  EXPECT_EQ(robot, 1);
  EXPECT_EQ(simulated, 2);
}

TEST_F(BatcherTest, OverloadIsRefusedAtOnceWithATimeToComeBack) {
  BatcherOptions options = OneThread();
  options.queue.capacity = 1;
  Batcher batcher(options);
  Asked held = Hold(batcher), waiting = Ask(batcher, Job(1));
  AwaitWaiting(batcher, 1);
  Asked refused = Ask(batcher, Job(2));
  const absl::Status status = refused.answer.get().status();  // while the thread is held
  EXPECT_TRUE(absl::IsResourceExhausted(status)) << status;
  EXPECT_GT(RetryAfter(status), absl::ZeroDuration());
  policy_->gate.Notify();
  EXPECT_TRUE(waiting.answer.get().ok());
  EXPECT_EQ(batcher.counters().overloaded, 1u);
}

TEST_F(BatcherTest, MetricsShowBatchSizesWhatWaitsAndWhyPredictionsWereRefused) {
  Metrics metrics;
  BatcherOptions options = OneThread();
  options.queue.capacity = 2;
  Batcher batcher(options, nullptr, &metrics);
  Asked held = Hold(batcher), a = Ask(batcher, Job(1)), b = Ask(batcher, Job(2));
  AwaitWaiting(batcher, 2);
  EXPECT_FALSE(Ask(batcher, Job(3)).answer.get().ok());
  EXPECT_THAT(metrics.Text(), ::testing::HasSubstr("robostress_predictions_waiting 2"));
  policy_->gate.Notify();
  for (Asked* asked : {&held, &a, &b}) EXPECT_TRUE(asked->answer.get().ok());
  EXPECT_THAT(metrics.Text(),
              ::testing::AllOf(::testing::HasSubstr("robostress_predictions_total 3"),
                               ::testing::HasSubstr("robostress_batch_size_bucket{le=\"1\"} 1"),
                               ::testing::HasSubstr("robostress_batch_size_bucket{le=\"2\"} 2"),
                               ::testing::HasSubstr(
                                   "robostress_predictions_refused_total{reason=\"overload\"} 1"),
                               ::testing::HasSubstr("robostress_predictions_waiting 0")));
}

TEST_F(BatcherTest, ADeadlineEndsTheWaitAndAStaleObservationIsReplaced) {
  Batcher batcher(OneThread());
  Asked held = Hold(batcher);
  PredictionJob hurried = Job(1);
  hurried.deadline = absl::Milliseconds(30);
  Asked late = Ask(batcher, hurried);
  EXPECT_TRUE(absl::IsDeadlineExceeded(late.answer.get().status()));
  PredictionJob async = Job(2);
  async.replaceable = true;
  Asked stale = Ask(batcher, async);
  AwaitWaiting(batcher, 1);
  Asked fresh = Ask(batcher, async);
  EXPECT_TRUE(absl::IsAborted(stale.answer.get().status()));
  policy_->gate.Notify();
  EXPECT_TRUE(fresh.answer.get().ok());
  EXPECT_EQ(batcher.counters().late, 1u);
  EXPECT_EQ(batcher.counters().replaced, 1u);
}

TEST_F(BatcherTest, CancellationByTheClientOrTheSessionLeavesTheQueue) {
  Batcher batcher(OneThread());
  Asked held = Hold(batcher);
  std::atomic<bool> gone = false;
  PredictionJob job = Job(1);
  job.cancelled = [&gone] { return gone.load(); };
  Asked client = Ask(batcher, job), session = Ask(batcher, Job(2));
  AwaitWaiting(batcher, 2);
  gone = true;
  EXPECT_TRUE(absl::IsCancelled(client.answer.get().status()));
  batcher.Cancel(2);
  EXPECT_TRUE(absl::IsCancelled(session.answer.get().status()));
  EXPECT_EQ(batcher.counters().waiting, 0);
  policy_->gate.Notify();
}

TEST_F(BatcherTest, StopAnswersWhatWaitsAndRefusesWhatComes) {
  auto batcher = std::make_unique<Batcher>(OneThread());
  Asked held = Hold(*batcher), waiting = Ask(*batcher, Job(1));
  AwaitWaiting(*batcher, 1);
  std::thread stopping([&batcher] { batcher->Stop(); });
  EXPECT_TRUE(absl::IsCancelled(waiting.answer.get().status()));
  Asked after = Ask(*batcher, Job(2));
  EXPECT_TRUE(absl::IsCancelled(after.answer.get().status()));
  policy_->gate.Notify();
  EXPECT_TRUE(held.answer.get().ok());
  stopping.join();
}

TEST_F(BatcherTest, AWindowWaitsForABatchToFill) {
  BatcherOptions options = OneThread(3);
  options.window = absl::Seconds(60);  // it is full long before
  Batcher batcher(options);
  std::vector<Asked> asked;
  for (uint64_t i = 0; i < 3; ++i) asked.push_back(Ask(batcher, Job(i)));
  for (Asked& a : asked) EXPECT_EQ(a.answer.get()->batch_size, 3);
}

TEST_F(BatcherTest, ThreadsThatAreIdleShareWhatWaits) {
  BatcherOptions options;
  options.threads = 4;
  Batcher batcher(options);
  std::vector<Asked> asked;
  for (uint64_t round = 0; round < 10; ++round) {
    for (uint64_t i = 0; i < 8; ++i) asked.push_back(Ask(batcher, Job(i)));
    for (uint64_t i = 0; i < 8; ++i) {
      const auto answer = asked[8 * round + i].answer.get();
      ASSERT_TRUE(answer.ok());
      ASSERT_TRUE(BitEqual(answer->raw, Alone(Job(i), nullptr)));
    }
  }
}

TEST_F(BatcherTest, UpdatesPauseWhileAPredictionWaitsOrIsComputed) {
  UpdatePacer pacer({1, 0.001});
  Batcher batcher(OneThread(), &pacer);
  Asked held = Hold(batcher);
  absl::Notification updated;
  std::thread updating([&] {
    const UpdatePacer::Update update(&pacer, UpdatePacer::Kind::kAsync);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    UpdatePacer::YieldPoint();
    updated.Notify();
  });
  EXPECT_FALSE(updated.WaitForNotificationWithTimeout(absl::Milliseconds(50)));
  policy_->gate.Notify();
  EXPECT_TRUE(held.answer.get().ok());
  updated.WaitForNotification();
  updating.join();
}

}  // namespace
}  // namespace robostress
