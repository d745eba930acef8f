#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <set>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"
#include "server/inference/update_pacer.h"

namespace robostress {

// The threads on which adapters learn, shared by all sessions and apart from those that predict: an
// asynchronous prediction never waits for an update. Jobs of one owner run in the order posted, one
// at a time; owners take turns. How many jobs an owner has waiting is the owner's to bound
// (Session::kMaxPendingUpdates).
class AdaptationLoop {
 public:
  struct Options {
    int threads = 1;
    // What its jobs yield to, between any two operators (server/inference/update_pacer.h); null:
    // nothing.
    UpdatePacer* pacer = nullptr;
    UpdatePacer::Kind kind = UpdatePacer::Kind::kAsync;
    int nice = 0;  // added to its threads' nice value: the kernel prefers those that predict
  };

  explicit AdaptationLoop(const Options& options);
  explicit AdaptationLoop(int threads) : AdaptationLoop(Options{threads}) {}
  ~AdaptationLoop() { Stop(); }

  // Any thread. After Stop the job is dropped.
  void Post(uint64_t owner, std::function<void()> job) ABSL_LOCKS_EXCLUDED(mu_);
  // Completes the jobs that are running, drops those that wait, joins.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run(int index, const Options& options);
  bool HasWorkOrStopped() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    mu_.AssertHeld();
    return stopped_ || !ready_.empty();
  }

  absl::Mutex mu_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  std::map<uint64_t, std::deque<std::function<void()>>> jobs_ ABSL_GUARDED_BY(mu_);
  std::deque<uint64_t> ready_ ABSL_GUARDED_BY(mu_);  // owners with jobs and none running
  std::set<uint64_t> running_ ABSL_GUARDED_BY(mu_);
  std::vector<std::thread> threads_;
};

}  // namespace robostress
