#pragma once

#include "absl/types/span.h"
#include "common/rollout/policy_endpoint.h"

namespace robostress {

struct JointDescription {
  const char* name;         // "J1": as scenario files and logs call it
  double lower, upper;      // of what it may be told [rad]
  double max_velocity;      // [rad/s]
  double max_acceleration;  // [rad/s^2]; 0: its controller names none
  double torque_limit;      // of its motor [Nm]
};

// What an arm is. Nothing is concluded from its name.
struct RobotDescription {
  const char* name;
  absl::Span<const JointDescription> joints;  // from the base on, gripper excluded
  ControlSpace control_space;                 // of the commands it takes
  double control_period_s;                    // between two of them
  double reach;                               // from the second joint to the tool [m]
};

// The simulated arm: limits of joints and motors as in robosuite 1.4.0.
inline constexpr JointDescription kPandaJoints[] = {
    {"J1", -2.8973, 2.8973, 2.2, 0, 80}, {"J2", -1.7628, 1.7628, 2.2, 0, 80},
    {"J3", -2.8973, 2.8973, 2.2, 0, 80}, {"J4", -3.0718, -0.0698, 2.2, 0, 80},
    {"J5", -2.8973, 2.8973, 2.2, 0, 80}, {"J6", -0.0175, 3.7525, 2.2, 0, 12},
    {"J7", -2.8973, 2.8973, 2.2, 0, 12},
};
inline constexpr RobotDescription kPanda = {"Panda", kPandaJoints, ControlSpace::kEndEffector, 0.05,
                                            0.85};

// AgileX Piper. Joint limits of the SDK and of the 2025 robot description, what a sound arm answers
// up to its 0.1 degrees; velocity of the firmware; acceleration as delivered; torque: the range of
// torque commands (pyAgxArm pull request 59).
inline constexpr JointDescription kPiperJoints[] = {
    {"J1", -2.6179, 2.6179, 3, 5, 32}, {"J2", 0, 3.14, 3, 5, 32},
    {"J3", -2.967, 0, 3, 5, 32},       {"J4", -1.745, 1.745, 3, 5, 8},
    {"J5", -1.22, 1.22, 3, 5, 8},      {"J6", -2.0944, 2.0944, 3, 5, 8},
};
inline constexpr RobotDescription kPiper = {"Piper", kPiperJoints, ControlSpace::kJoint, 1.0 / 30,
                                            0.63};

}  // namespace robostress
