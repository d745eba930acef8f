#pragma once

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"

namespace robostress {

// A robot in a task, as the rollout loop sees it: simulated or real. One thread.
class Robot {
 public:
  virtual ~Robot() = default;
  // Puts the task into reproducible state `initial_state` and settles. Hidden error states start
  // anew.
  virtual absl::Status Reset(int initial_state) = 0;
  // Renders only the views that the spec asks for.
  virtual absl::StatusOr<Observation> Observe(const PolicySpec& spec) = 0;
  virtual absl::StatusOr<RobotState> Measure() = 0;
  // One control step with a normalised command [action_dim].
  virtual absl::Status Step(const Eigen::VectorXf& command) = 0;
  virtual bool Success() const = 0;
  virtual int horizon() const = 0;  // control steps
};

}  // namespace robostress
