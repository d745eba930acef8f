#include "server/wire/fair_executor.h"

#include <pthread.h>

#include <set>
#include <utility>

namespace robostress {
namespace {

int CountOf(const std::map<std::string, int>& counts, const std::string& key) {
  const auto found = counts.find(key);
  return found == counts.end() ? 0 : found->second;
}

void CountDown(std::map<std::string, int>& counts, const std::string& key) {
  const auto found = counts.find(key);
  if (--found->second == 0) counts.erase(found);
}

}  // namespace

void FairExecutor::Post(const std::string& client, const std::string& session,
                        std::function<void()> job) {
  absl::MutexLock lock(&mu_);
  waiting_.push_back({client, session, std::move(job)});
  Dispatch();
}

void FairExecutor::Dispatch() {
  while (running_ < options_.threads) {
    auto best = waiting_.end();
    std::set<std::string> passed;  // sessions whose earlier job must wait
    for (auto at = waiting_.begin(); at != waiting_.end(); ++at) {
      const bool session_waits =
          !at->session.empty() && (passed.count(at->session) > 0 ||
                                   CountOf(sessions_, at->session) >= options_.per_session);
      if (session_waits || CountOf(clients_, at->client) >= options_.per_client) {
        if (!at->session.empty()) passed.insert(at->session);
        continue;
      }
      if (best == waiting_.end() ||
          CountOf(clients_, at->client) < CountOf(clients_, best->client)) {
        best = at;
      }
    }
    if (best == waiting_.end()) return;
    ++clients_[best->client];
    if (!best->session.empty()) ++sessions_[best->session];
    ++running_;
    given_.push_back(std::move(*best));
    waiting_.erase(best);
    if (!stopped_ && static_cast<int>(given_.size()) > idle_ &&
        static_cast<int>(threads_.size()) < options_.threads) {
      ++idle_;  // the new one, until it takes a job
      threads_.emplace_back([this] { Work(); });
    }
  }
}

void FairExecutor::Work() {
  pthread_setname_np(pthread_self(), options_.name.substr(0, 15).c_str());
  const auto has_work = [this] {
    mu_.AssertHeld();
    return !given_.empty() || (stopped_ && waiting_.empty());
  };
  while (true) {
    Job job;
    {
      absl::MutexLock lock(&mu_);
      mu_.Await(absl::Condition(&has_work));
      if (given_.empty()) return;
      --idle_;
      job = std::move(given_.front());
      given_.pop_front();
    }
    job.run();
    job.run = nullptr;  // what it holds is let go of before the next one is looked for
    absl::MutexLock lock(&mu_);
    CountDown(clients_, job.client);
    if (!job.session.empty()) CountDown(sessions_, job.session);
    --running_;
    ++idle_;
    Dispatch();
  }
}

void FairExecutor::Stop() {
  std::vector<std::thread> threads;
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
    threads.swap(threads_);
  }
  for (std::thread& thread : threads) thread.join();
}

int FairExecutor::waiting() const {
  absl::MutexLock lock(&mu_);
  return static_cast<int>(waiting_.size());
}

int FairExecutor::threads() const {
  absl::MutexLock lock(&mu_);
  return static_cast<int>(threads_.size());
}

}  // namespace robostress
