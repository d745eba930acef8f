#include "common/clock.h"

#include <time.h>

#include <cerrno>

namespace robostress {
namespace {
constexpr int64_t kNsPerSecond = 1'000'000'000;
}  // namespace

int64_t MonotonicClock::now_ns() const {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kNsPerSecond + now.tv_nsec;
}

void MonotonicClock::SleepUntil(int64_t deadline_ns) {
  const timespec deadline{deadline_ns / kNsPerSecond, deadline_ns % kNsPerSecond};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, nullptr) == EINTR) {
  }
}

void ManualClock::SleepUntil(int64_t deadline_ns) {
  int64_t now = now_ns();
  while (now < deadline_ns &&
         !now_ns_.compare_exchange_weak(now, deadline_ns, std::memory_order_acq_rel)) {
  }
}

}  // namespace robostress
