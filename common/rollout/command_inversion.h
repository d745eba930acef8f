#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// Chooses at every control step what is sent so that an arm with errors moves as one without. One
// robot, one thread; it takes every command that it chose as sent.
class CommandInversion {
 public:
  virtual ~CommandInversion() = default;
  virtual void StartEpisode() = 0;
  // [action_dim] for rows [n, action_dim] of the policy, the first of them due now; n >= 1.
  virtual absl::StatusOr<Eigen::VectorXf> Command(const Eigen::MatrixXf& rows,
                                                  const RobotState& now) = 0;
};

}  // namespace robostress
