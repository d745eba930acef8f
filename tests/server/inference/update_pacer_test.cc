#include "server/inference/update_pacer.h"

#include <ATen/ThreadLocalState.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <atomic>
#include <thread>

#include "absl/synchronization/notification.h"
#include "adapter/lora_adapter.h"
#include "server/inference/operator_hook.h"
#include "tests/adapter/fake_policy.h"

namespace robostress {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// Computes for `d` by the clock.
void Spin(milliseconds d) {
  const auto end = steady_clock::now() + d;
  while (steady_clock::now() < end) {
  }
}

// How long a yield point pauses after at least 20 ms of work.
absl::Duration PauseAfterWork(UpdatePacer& pacer, UpdatePacer::Kind kind) {
  const absl::Duration before = pacer.paused();
  const UpdatePacer::Update update(&pacer, kind);
  Spin(milliseconds(20));
  UpdatePacer::YieldPoint();
  return pacer.paused() - before;
}

TEST(UpdatePacer, AnUpdateRunsOnWhileNobodyPredicts) {
  UpdatePacer pacer({1, 0.01});
  EXPECT_EQ(PauseAfterWork(pacer, UpdatePacer::Kind::kAsync), absl::ZeroDuration());
  UpdatePacer::YieldPoint();  // outside of an update: nothing
}

TEST(UpdatePacer, AnUpdatePausesUntilThePredictionIsAnswered) {
  UpdatePacer pacer({1, 0.001});  // on its own it would pause for 20 s
  pacer.PredictionArrived(Priority::kSimulation);
  absl::Notification resumed;
  std::thread updating([&] {
    PauseAfterWork(pacer, UpdatePacer::Kind::kAsync);
    resumed.Notify();
  });
  EXPECT_FALSE(resumed.WaitForNotificationWithTimeout(absl::Milliseconds(60)));
  pacer.PredictionAnswered(Priority::kSimulation);
  EXPECT_TRUE(resumed.WaitForNotificationWithTimeout(absl::Seconds(5)));
  updating.join();
  EXPECT_GT(pacer.paused(), absl::ZeroDuration());
}

TEST(UpdatePacer, WhilePredictionsNeverEndAnUpdateGetsItsShare) {
  UpdatePacer pacer({1, 0.25});
  pacer.PredictionArrived(Priority::kSimulation);
  EXPECT_GE(PauseAfterWork(pacer, UpdatePacer::Kind::kAsync),
            absl::Milliseconds(60));  // 20 ms of 80
  UpdatePacer greedy({1, 1});
  greedy.PredictionArrived(Priority::kRobot);
  EXPECT_EQ(PauseAfterWork(greedy, UpdatePacer::Kind::kAsync), absl::ZeroDuration());
}

TEST(UpdatePacer, UpdatesThatRunTogetherShareTheShare) {
  UpdatePacer pacer({1, 0.25});
  pacer.PredictionArrived(Priority::kSimulation);
  absl::Notification begun, done;
  std::thread other([&] {
    const UpdatePacer::Update update(&pacer, UpdatePacer::Kind::kAsync);
    begun.Notify();
    done.WaitForNotification();
  });
  begun.WaitForNotification();
  EXPECT_GE(PauseAfterWork(pacer, UpdatePacer::Kind::kAsync),
            absl::Milliseconds(140));  // 20 ms of 160
  done.Notify();
  other.join();
}

TEST(UpdatePacer, UpdatesYieldOnlyWhenTheCoresAreTaken) {
  UpdatePacer pacer({2, 0.25});
  pacer.PredictionArrived(Priority::kSimulation);  // one prediction, one update, two cores
  EXPECT_EQ(PauseAfterWork(pacer, UpdatePacer::Kind::kAsync), absl::ZeroDuration());
  pacer.PredictionArrived(Priority::kSimulation);
  EXPECT_GE(PauseAfterWork(pacer, UpdatePacer::Kind::kAsync), absl::Milliseconds(60));
}

TEST(UpdatePacer, ALockstepUpdateYieldsToRealArmsOnly) {
  UpdatePacer pacer({1, 0.25});
  pacer.PredictionArrived(Priority::kSimulation);
  EXPECT_EQ(PauseAfterWork(pacer, UpdatePacer::Kind::kLockstep), absl::ZeroDuration());
  pacer.PredictionArrived(Priority::kRobot);
  EXPECT_GE(PauseAfterWork(pacer, UpdatePacer::Kind::kLockstep), absl::Milliseconds(60));
}

int calls = 0;
void CountCall() { ++calls; }

std::vector<std::shared_ptr<const TrainingChunk>> SomeBatch(const FakePolicy& policy) {
  std::vector<std::shared_ptr<const TrainingChunk>> batch;
  for (int i = 0; i < 4; ++i) {
    auto chunk = std::make_shared<TrainingChunk>();
    chunk->context = *policy.Encode(FakePolicy::MakeObservation(i));
    chunk->target = torch::zeros({policy.horizon(), policy.model_action_dim()});
    batch.push_back(std::move(chunk));
  }
  return batch;
}

TEST(OperatorHook, IsCalledBetweenTheOperatorsOfForwardAndBackward) {
  const torch::Tensor x = torch::randn({8, 8}).requires_grad_(true);
  calls = 0;
  torch::Tensor loss;
  {
    const OperatorHook hook(&CountCall);
    loss = torch::tanh(torch::matmul(x, x)).sum();
    const int forward = calls;
    EXPECT_GE(forward, 3);
    loss.backward();
    EXPECT_GE(calls, forward + 4);
  }
  const int before = calls;
  x.detach().exp();
  EXPECT_EQ(calls, before);
}

// As LibTorch's own threads do, which differentiate what ran on a GPU.
TEST(OperatorHook, LeavesThreadsAloneThatTakeOnTheStateOfItsThread) {
  const torch::Tensor x = torch::randn({8, 8});
  calls = 0;
  const OperatorHook hook(&CountCall);
  const at::ThreadLocalState state;
  std::thread([&] {
    const at::ThreadLocalStateGuard guard(state);
    EXPECT_TRUE(x.exp().defined());
  }).join();
  EXPECT_EQ(calls, 0);
  x.exp();
  EXPECT_GT(calls, 0);
}

TEST(OperatorHook, AnUpdateThatIsInterruptedHasTheBitsOfOneThatIsNot) {
  const FakePolicy policy;
  const LoraOptions options = LoraOptions::At(0.01);
  const auto batch = SomeBatch(policy);
  const auto alone = *LoraAdapter::Create(&policy, options, StreamKey("pacer"));
  const auto paced = *LoraAdapter::Create(&policy, options, StreamKey("pacer"));
  ASSERT_TRUE(alone->Update(0, batch)->applied);
  UpdatePacer pacer({1, 0.2});
  pacer.PredictionArrived(Priority::kSimulation);
  {
    const OperatorHook hook(&UpdatePacer::YieldPoint);
    const UpdatePacer::Update update(&pacer, UpdatePacer::Kind::kAsync);
    ASSERT_TRUE(paced->Update(0, batch)->applied);
  }
  EXPECT_GT(pacer.paused(), absl::ZeroDuration());
  EXPECT_TRUE(BitEqual(*alone->snapshot(), *paced->snapshot()));
}

}  // namespace
}  // namespace robostress
