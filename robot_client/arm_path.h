#pragma once

#include "absl/status/status.h"
#include "robot_client/arm_model.h"
#include "robot_client/control/control_loop.h"

namespace robostress {

// How fast a way of the client's own is.
struct PathLimits {
  double joint_velocity = 0.6;     // [rad/s]
  double joint_acceleration = 3;   // [rad/s^2]
  double joint_jerk = 30;          // [rad/s^3]
  double gripper_velocity = 0.05;  // [m/s]
};

// Straight in joint space from one pose to another with the quintic of least jerk (Flash and Hogan,
// J. Neurosci. 5, 1985), its peaks within the limits: 1.875 d/T, 5.774 d/T^2, 60 d/T^3. One row per
// `period_s`, the last is `to`.
ArmPath StraightPath(const ArmAxes& axes, const ArmVector& from, const ArmVector& to,
                     const PathLimits& limits, double period_s);

// FAILED_PRECONDITION names the first bound that a way crosses, and how deep its end lies.
absl::Status CheckPath(const ArmModel& model, const ArmPath& path);
// INVALID_ARGUMENT where a pose lies outside of the arm's limits or the workspace.
absl::Status CheckPose(const char* name, const ArmVector& pose, const ArmLimits& limits,
                       const ArmModel* model);

}  // namespace robostress
