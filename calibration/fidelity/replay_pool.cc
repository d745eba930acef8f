#include "calibration/fidelity/replay_pool.h"

#include <atomic>
#include <thread>
#include <utility>

#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

// The values, or the first failure.
template <class T>
absl::StatusOr<std::vector<T>> All(std::vector<absl::StatusOr<T>> results) {
  std::vector<T> values;
  for (absl::StatusOr<T>& result : results) {
    if (!result.ok()) return result.status();
    values.push_back(*std::move(result));
  }
  return values;
}

}  // namespace

absl::StatusOr<std::unique_ptr<ReplayPool>> ReplayPool::Create(const ReplayTask& task,
                                                               double payload_kg, int threads) {
  auto pool = std::make_unique<ReplayPool>();
  for (int i = 0; i < threads; ++i) {
    RS_ASSIGN_OR_RETURN(std::unique_ptr<ReplayArm> arm, ReplayArm::Create(task, payload_kg));
    pool->arms_.push_back(std::move(arm));
  }
  return pool;
}

template <class Call>
void ReplayPool::Distribute(int n, const Call& call) {
  std::atomic<int> next = 0;
  const auto work = [&](ReplayArm& arm) {
    for (int i = next++; i < n; i = next++) call(arm, i);
  };
  std::vector<std::jthread> others;
  for (size_t k = 1; k < arms_.size(); ++k) others.emplace_back([&, k] { work(*arms_[k]); });
  work(*arms_[0]);
}

absl::StatusOr<std::vector<Replay>> ReplayPool::Run(const std::vector<Job>& jobs) {
  std::vector<absl::StatusOr<Replay>> results(jobs.size(), Replay());
  Distribute(static_cast<int>(jobs.size()), [&](ReplayArm& arm, int i) {
    results[i] = arm.Run(jobs[i].layout, *jobs[i].demonstration, jobs[i].conditions);
  });
  return All(std::move(results));
}

absl::StatusOr<std::vector<Demonstration>> ReplayPool::Record(const std::vector<int>& layouts,
                                                              const Scenario& scenario) {
  std::vector<absl::StatusOr<Demonstration>> results(layouts.size(), Demonstration());
  Distribute(static_cast<int>(layouts.size()),
             [&](ReplayArm& arm, int i) { results[i] = arm.Record(layouts[i], scenario); });
  return All(std::move(results));
}

}  // namespace robostress::calibration
