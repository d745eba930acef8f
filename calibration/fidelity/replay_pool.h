#pragma once

#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/fidelity/replay_arm.h"

namespace robostress::calibration {

// Several equal arms that replay side by side.
class ReplayPool {
 public:
  static absl::StatusOr<std::unique_ptr<ReplayPool>> Create(const ReplayTask& task,
                                                            double payload_kg, int threads);

  struct Job {
    int layout = 0;
    const Demonstration* demonstration = nullptr;
    ReplayConditions conditions;
  };
  // In the order of the jobs, whatever the threads; the first failure if any fails.
  absl::StatusOr<std::vector<Replay>> Run(const std::vector<Job>& jobs);
  absl::StatusOr<std::vector<Demonstration>> Record(const std::vector<int>& layouts,
                                                    const Scenario& scenario);
  const ReplayArm& arm() const { return *arms_[0]; }

 private:
  // call(arm, i) for i in [0, n), every arm on a thread of its own.
  template <class Call>
  void Distribute(int n, const Call& call);

  std::vector<std::unique_ptr<ReplayArm>> arms_;
};

}  // namespace robostress::calibration
