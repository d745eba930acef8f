#include "server/inference/adaptation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <vector>

#include "absl/synchronization/blocking_counter.h"
#include "absl/synchronization/notification.h"

namespace robostress {
namespace {

TEST(AdaptationLoop, RunsTheJobsOfOneOwnerInOrderAndOneAtATime) {
  std::vector<int> order;  // no lock: jobs of one owner must not overlap
  absl::BlockingCounter done(200);
  AdaptationLoop loop(4);
  for (int i = 0; i < 200; ++i) {
    loop.Post(1, [&order, &done, i] {
      order.push_back(i);
      done.DecrementCount();
    });
  }
  done.Wait();
  for (int i = 0; i < 200; ++i) EXPECT_EQ(order[i], i);
}

TEST(AdaptationLoop, OwnersDoNotWaitForEachOther) {
  AdaptationLoop loop(2);
  absl::Notification release, other;
  loop.Post(1, [&release] { release.WaitForNotification(); });
  loop.Post(2, [&other] { other.Notify(); });
  other.WaitForNotification();  // would hang behind owner 1
  release.Notify();
}

TEST(AdaptationLoop, OwnersTakeTurns) {
  AdaptationLoop loop(1);
  absl::Notification start;
  std::vector<int> order;
  absl::BlockingCounter done(4);
  loop.Post(9, [&start] { start.WaitForNotification(); });
  for (const int owner : {1, 1, 2, 2}) {
    loop.Post(owner, [&order, &done, owner] {
      order.push_back(owner);
      done.DecrementCount();
    });
  }
  start.Notify();
  done.Wait();
  EXPECT_THAT(order, ::testing::ElementsAre(1, 2, 1, 2));
}

TEST(AdaptationLoop, StopCompletesWhatRunsAndDropsWhatWaits) {
  std::atomic<int> ran = 0;
  absl::Notification started, release;
  AdaptationLoop loop(1);
  loop.Post(1, [&] {
    started.Notify();
    release.WaitForNotification();
    ++ran;
  });
  loop.Post(1, [&ran] { ++ran; });
  started.WaitForNotification();
  std::thread stopper([&loop] { loop.Stop(); });
  // Stop has closed intake before it joins; the job is released only after it was asked to stop.
  loop.Post(2, [&ran] { ++ran; });
  release.Notify();
  stopper.join();
  EXPECT_GE(ran, 1);
  const int after_stop = ran;
  loop.Post(1, [&ran] { ++ran; });
  EXPECT_EQ(ran, after_stop);
}

}  // namespace
}  // namespace robostress
