#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// An arm in one sub-step of 2 ms, as a robot with encoders and torque commands would log it.
struct JointSample {
  using Vector = Eigen::Matrix<double, 7, 1>;
  double t = 0;  // [s] since Reset: settling is recorded
  Vector q, dq;  // readings at the start of the sub-step [rad], [rad/s]
  Vector tau;    // asked of the motors over the sub-step, within their limits, errors left out [Nm]
  double contact_N = 0;  // sum of the contact forces on arm and gripper in the sub-step [N]
};

// One recorded episode: joints at 500 Hz from before the arm moves, so that delays and hidden
// states have their past in the log; and what replaying it needs: initial state, actions, and the
// state that each control step reached.
struct JointLog {
  static constexpr double kRateHz = 500;
  std::string suite, scenario, policy;
  int severity = 5, task = 0, episode = 0, initial_state = 0;
  bool success = false;
  std::vector<JointSample> samples;
  std::vector<Eigen::VectorXf> actions;  // [T] commands as sent, [7] each
  std::vector<RobotState> states;        // [T + 1] (0 without a step); the simulator's truth
};

// safetensors, published whole: t, contact_N [n]; q, dq, tau [n, 7]; actions [T, 7], so that the
// file is one of policy replay too; step_q [T + 1, 7], step_tool [T + 1, 7] (p_base_tool [m],
// quaternion w x y z); everything else as metadata.
absl::Status WriteJointLog(const JointLog& log, const std::string& file);
// Errors name file and tensor or metadata key.
absl::StatusOr<JointLog> ReadJointLog(const std::string& file);

}  // namespace robostress
