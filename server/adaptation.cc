#include "server/adaptation.h"

#include <pthread.h>

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/torch_threads.h"

namespace robostress {

AdaptationLoop::AdaptationLoop(int threads) {
  for (int i = 0; i < threads; ++i) threads_.emplace_back([this, i] { Run(i); });
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

void AdaptationLoop::Run(int index) {
  pthread_setname_np(pthread_self(), absl::StrCat("adapt-", index).c_str());
  UseOneTorchThread();
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
    job();
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
