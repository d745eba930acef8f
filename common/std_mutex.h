#pragma once

#include <condition_variable>
#include <mutex>

#include "absl/base/thread_annotations.h"

namespace robostress {

// std::mutex with the annotations that Clang's thread-safety analysis reads. For waits that are
// timed: those of std follow the monotonic clock, those of absl::Mutex the time of day. Everything
// else takes absl::Mutex.
class ABSL_LOCKABLE StdMutex {
 private:
  friend class StdLock;
  std::mutex mu_;  // not analysed: this class is
};

// Holds a StdMutex while it lives, or between Lock and Unlock.
class ABSL_SCOPED_LOCKABLE StdLock {
 public:
  explicit StdLock(StdMutex& mu) ABSL_EXCLUSIVE_LOCK_FUNCTION(mu) : lock_(mu.mu_) {}
  ~StdLock() ABSL_UNLOCK_FUNCTION() {}
  StdLock(const StdLock&) = delete;
  StdLock& operator=(const StdLock&) = delete;

  void Lock() ABSL_EXCLUSIVE_LOCK_FUNCTION() { lock_.lock(); }
  void Unlock() ABSL_UNLOCK_FUNCTION() { lock_.unlock(); }
  // What a std::condition_variable waits with. The mutex is held again when its wait returns.
  std::unique_lock<std::mutex>& waiting() { return lock_; }

 private:
  std::unique_lock<std::mutex> lock_;
};

}  // namespace robostress
