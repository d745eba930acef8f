#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"

namespace robostress {

// A value that one writer replaces as a whole while many read it. A reader keeps what it got for
// as long as it likes. Any thread.
template <class Value>
class Published {
 public:
  Published() : Published(Value()) {}
  explicit Published(Value value) : value_(std::make_shared<const Value>(std::move(value))) {}

  // Never null.
  std::shared_ptr<const Value> Get() const ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    return value_;
  }
  void Set(Value value) ABSL_LOCKS_EXCLUDED(mu_) {
    auto next = std::make_shared<const Value>(std::move(value));
    absl::MutexLock lock(&mu_);
    value_.swap(next);  // the old one ends after the lock, unless somebody reads it
    ++generation_;
  }
  // Another one after every Set: what was decided by an earlier value may be decided again. Asked
  // before Get, it is never newer than what Get returns.
  uint64_t generation() const { return generation_; }

 private:
  mutable absl::Mutex mu_;
  std::shared_ptr<const Value> value_ ABSL_GUARDED_BY(mu_);
  std::atomic<uint64_t> generation_{1};
};

}  // namespace robostress
