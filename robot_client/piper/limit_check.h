#pragma once

#include <array>
#include <optional>

#include "absl/status/status.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/robot_arm.h"

namespace robostress::piper {

// Whether what a joint answered can be the limits of a Piper: an arm whose flash is corrupted
// answers, for example, -0.1 degrees for both ends (pyAgxArm issue 55). kFailedPrecondition names
// the joint, the field, the value and what was expected:
//   lower and upper within the mechanical stops, their distance at least 0.5 rad;
//   max_speed from 0.5 to 3.5 rad/s (a factor of ten, see JointLimit, falls outside);
//   max_acceleration from 0.5 to 20 rad/s^2.
absl::Status CheckJointLimit(const JointLimit& limit, const JointAcceleration& acceleration);

// What commands may use: the joints' answers within the vendor's ranges, `margin` [rad] inside
// both; the gripper from closed to gripper_range [m], its speed and acceleration unlimited by the
// arm. Every answer must be there.
ArmLimits UsableLimits(const std::array<std::optional<JointLimit>, kJoints>& limits,
                       const std::array<std::optional<JointAcceleration>, kJoints>& accelerations,
                       double gripper_range, double margin);

}  // namespace robostress::piper
