#pragma once

#include <deque>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"

namespace robostress {

// Threads for what may wait: a batch, a disk, feedback that was announced. No client can occupy
// them all, and no session more than a few, so what one of them waits for never stops another's.
struct FairExecutorOptions {
  std::string name = "call";  // of the threads
  int threads = 96;           // at most; made when they are needed
  int per_client = 72;        // jobs of one client at a time
  int per_session = 2;        // jobs of one session at a time; of "" as many as of the client
};

// Jobs of a session begin in the order they came. Of several clients that wait, the one with the
// fewest jobs under way goes first. Any thread.
class FairExecutor {
 public:
  explicit FairExecutor(const FairExecutorOptions& options) : options_(options) {}
  ~FairExecutor() { Stop(); }
  FairExecutor(const FairExecutor&) = delete;
  FairExecutor& operator=(const FairExecutor&) = delete;

  // The queue is bounded by who posts: a call has at most one job here.
  void Post(const std::string& client, const std::string& session, std::function<void()> job)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Runs what waits, joins. Nothing may be posted after it.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  int waiting() const ABSL_LOCKS_EXCLUDED(mu_);
  int threads() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Job {
    std::string client, session;
    std::function<void()> run;
  };

  // Gives threads what may run now.
  void Dispatch() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Work() ABSL_LOCKS_EXCLUDED(mu_);

  const FairExecutorOptions options_;
  mutable absl::Mutex mu_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  int idle_ ABSL_GUARDED_BY(mu_) = 0;     // threads without a job
  int running_ ABSL_GUARDED_BY(mu_) = 0;  // jobs that threads have or are given
  std::deque<Job> waiting_ ABSL_GUARDED_BY(mu_);
  std::deque<Job> given_ ABSL_GUARDED_BY(mu_);  // counted below
  std::map<std::string, int> clients_ ABSL_GUARDED_BY(mu_), sessions_ ABSL_GUARDED_BY(mu_);
  std::vector<std::thread> threads_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
