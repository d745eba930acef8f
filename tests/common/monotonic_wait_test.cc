#include "common/monotonic_wait.h"

#include <gtest/gtest.h>

#include <chrono>
#include <thread>
#include <vector>

namespace robostress {
namespace {

using Monotonic = std::chrono::steady_clock;

struct Guarded {
  absl::Mutex mu;
  bool ready ABSL_GUARDED_BY(mu) = false;

  bool Await(absl::Duration timeout) {
    const absl::MutexLock lock(&mu);
    const auto is_ready = [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) { return ready; };
    return AwaitFor(mu, is_ready, timeout);
  }
  void MakeReady() {
    const absl::MutexLock lock(&mu);
    ready = true;
  }
};

TEST(MonotonicWait, AsksFirst) {
  Guarded guarded;
  EXPECT_FALSE(guarded.Await(absl::ZeroDuration()));
  EXPECT_FALSE(guarded.Await(-absl::InfiniteDuration()));
  guarded.MakeReady();
  EXPECT_TRUE(guarded.Await(absl::ZeroDuration()));
}

TEST(MonotonicWait, GivesUpAfterItsTimeAndNoEarlier) {
  Guarded guarded;
  const Monotonic::time_point begin = Monotonic::now();
  EXPECT_FALSE(guarded.Await(absl::Milliseconds(60)));
  EXPECT_GE(Monotonic::now() - begin, std::chrono::milliseconds(60));
}

TEST(MonotonicWait, EndsWhenTheConditionComes) {
  for (const absl::Duration timeout : {absl::Hours(1), absl::InfiniteDuration()}) {
    Guarded guarded;
    std::thread other([&] {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      guarded.MakeReady();
    });
    EXPECT_TRUE(guarded.Await(timeout));
    other.join();
  }
}

// Waits that begin and end in every order, with mutexes that are gone as soon as theirs is over.
TEST(MonotonicWait, KeepsTheTimesOfManyApart) {
  std::vector<std::thread> threads;
  for (int i = 0; i < 50; ++i) {
    threads.emplace_back([i] {
      for (int round = 0; round < 20; ++round) {
        Guarded guarded;
        const absl::Duration timeout = absl::Microseconds(100 + 997 * ((i * 7 + round * 13) % 10));
        const Monotonic::time_point begin = Monotonic::now();
        EXPECT_FALSE(guarded.Await(timeout));
        EXPECT_GE(absl::FromChrono(Monotonic::now() - begin), timeout);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace
}  // namespace robostress
