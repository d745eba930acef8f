#include "server/inference/adaptation.h"

#include <pthread.h>
#include <sys/resource.h>

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/inference/operator_hook.h"
#include "server/inference/torch_threads.h"

namespace robostress {

AdaptationLoop::AdaptationLoop(const Options& options) {
  for (int i = 0; i < options.threads; ++i)
    threads_.emplace_back([this, i, options] { Run(i, options); });
}

void AdaptationLoop::Post(uint64_t owner, std::function<void()> job) {
  absl::MutexLock lock(&mu_);
  if (stopped_) return;
  std::deque<std::function<void()>>& queue = jobs_[owner];
  queue.push_back(std::move(job));
  if (queue.size() == 1 && running_.count(owner) == 0) ready_.push_back(owner);
}

void AdaptationLoop::Stop() {
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
  }
  for (std::thread& thread : threads_) thread.join();
  threads_.clear();
  absl::MutexLock lock(&mu_);
  jobs_.clear();
  ready_.clear();
}

void AdaptationLoop::Run(int index, const Options& options) {
  pthread_setname_np(pthread_self(), absl::StrCat("adapt-", index).c_str());
  // Linux has a nice value per thread; 0 is the calling one. Raising it needs no rights.
  if (options.nice > 0) setpriority(PRIO_PROCESS, 0, getpriority(PRIO_PROCESS, 0) + options.nice);
  UseOneTorchThread();
  const OperatorHook hook(&UpdatePacer::YieldPoint);
  while (true) {
    uint64_t owner = 0;
    std::function<void()> job;
    {
      absl::MutexLock lock(&mu_);
      mu_.Await(absl::Condition(this, &AdaptationLoop::HasWorkOrStopped));
      if (stopped_) return;
      owner = ready_.front();
      ready_.pop_front();
      job = std::move(jobs_[owner].front());
      jobs_[owner].pop_front();
      running_.insert(owner);
    }
    {
      const UpdatePacer::Update update(options.pacer, options.kind);
      job();
    }
    job = nullptr;  // may hold the last reference to its session; not under the lock
    absl::MutexLock lock(&mu_);
    running_.erase(owner);
    if (jobs_[owner].empty()) {
      jobs_.erase(owner);
    } else {
      ready_.push_back(owner);
    }
  }
}

}  // namespace robostress
