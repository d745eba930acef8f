#pragma once

#include <atomic>
#include <cstdint>

namespace robostress {

// Where time comes from. Stamps of one clock may be compared; wall clocks are never used for
// pacing.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual int64_t now_ns() const = 0;  // any thread; never blocks, never allocates
  // Returns at `deadline_ns` or, when that is past, at once.
  virtual void SleepUntil(int64_t deadline_ns) = 0;
};

// CLOCK_MONOTONIC, slept on with absolute deadlines.
class MonotonicClock : public Clock {
 public:
  int64_t now_ns() const override;
  void SleepUntil(int64_t deadline_ns) override;
};

// Time that stands still until someone moves it: simulated time, shared by all that run in it.
class ManualClock : public Clock {
 public:
  explicit ManualClock(int64_t start_ns = 0) : now_ns_(start_ns) {}
  int64_t now_ns() const override { return now_ns_.load(std::memory_order_acquire); }
  // Moves time to the deadline: whoever sleeps is the one who lets it pass.
  void SleepUntil(int64_t deadline_ns) override;
  void Advance(int64_t ns) { now_ns_.fetch_add(ns, std::memory_order_acq_rel); }

 private:
  std::atomic<int64_t> now_ns_;
};

}  // namespace robostress
