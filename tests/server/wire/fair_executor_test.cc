#include "server/wire/fair_executor.h"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/blocking_counter.h"
#include "absl/synchronization/notification.h"
#include "absl/time/clock.h"

namespace robostress {
namespace {

TEST(FairExecutor, AClientWhoseJobsAllWaitLeavesThreadsToTheOthers) {
  FairExecutor executor({.threads = 4, .per_client = 3, .per_session = 4});
  absl::Notification release, other;
  for (int i = 0; i < 200; ++i)
    executor.Post("occupier", absl::StrCat(i), [&] { release.WaitForNotification(); });
  executor.Post("robot", "s", [&] { other.Notify(); });
  EXPECT_TRUE(other.WaitForNotificationWithTimeout(absl::Seconds(20)));
  EXPECT_LE(executor.threads(), 4);
  EXPECT_EQ(executor.waiting(), 197);
  release.Notify();
}

TEST(FairExecutor, ASessionWhoseJobsAllWaitLeavesThreadsToItsClientsOthers) {
  FairExecutor executor({.threads = 4, .per_client = 4, .per_session = 2});
  absl::Notification release, other;
  for (int i = 0; i < 50; ++i)
    executor.Post("client", "stuck", [&] { release.WaitForNotification(); });
  executor.Post("client", "well", [&] { other.Notify(); });
  EXPECT_TRUE(other.WaitForNotificationWithTimeout(absl::Seconds(20)));
  release.Notify();
}

TEST(FairExecutor, OfASessionNoMoreThanItsShareRunAtOnce) {
  constexpr int kMost = 2;
  FairExecutor executor({.threads = 4, .per_client = 4, .per_session = kMost});
  std::atomic<int> running{0}, most{0};
  for (int i = 0; i < 60; ++i) {
    executor.Post("client", "s", [&] {
      const int now = ++running;
      for (int seen = most; seen < now && !most.compare_exchange_weak(seen, now);) continue;
      absl::SleepFor(absl::Milliseconds(1));  // others have the time to begin
      --running;
    });
  }
  executor.Stop();
  EXPECT_EQ(most, kMost);
}

TEST(FairExecutor, JobsOfASessionBeginInTheOrderTheyCame) {
  FairExecutor executor({.threads = 4, .per_client = 4, .per_session = 1});
  std::vector<int> order;  // one at a time: per_session is 1
  for (int i = 0; i < 100; ++i) executor.Post("client", "s", [&order, i] { order.push_back(i); });
  executor.Stop();
  ASSERT_EQ(order.size(), 100u);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(order[static_cast<size_t>(i)], i);
}

TEST(FairExecutor, OfTwoThatWaitTheOneWithLessUnderWayGoesFirst) {
  FairExecutor executor({.threads = 2, .per_client = 2, .per_session = 2});
  absl::Notification first, second;
  executor.Post("a", "", [&] { first.WaitForNotification(); });
  executor.Post("a", "", [&] { second.WaitForNotification(); });
  std::atomic<bool> a_was_first{false};
  absl::BlockingCounter done(2);
  auto b_ran = std::make_shared<std::atomic<bool>>(false);
  executor.Post("a", "", [&] {
    a_was_first = !*b_ran;
    done.DecrementCount();
  });
  executor.Post("b", "", [&, b_ran] {
    *b_ran = true;
    done.DecrementCount();
  });
  first.Notify();
  done.Wait();
  EXPECT_FALSE(a_was_first);
  second.Notify();
}

TEST(FairExecutor, StopRunsWhatWaits) {
  std::atomic<int> ran{0};
  FairExecutor executor({.threads = 2, .per_client = 1, .per_session = 1});
  for (int i = 0; i < 100; ++i) executor.Post("client", "s", [&ran] { ++ran; });
  executor.Stop();
  EXPECT_EQ(ran, 100);
}

}  // namespace
}  // namespace robostress
