#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/protocol.h"

// Commands that our client never sends and other programs do: Cartesian targets (0x152 to 0x154)
// and the torque mode (0x15A to 0x15F).
namespace robostress::piper {

// As EncodeEndPose has it, under identifiers of targets: pair 0: x, y; 1: z, roll; 2: pitch, yaw
// [m], [rad].
std::optional<JointPair> DecodePoseTarget(const CanFrame& frame);

// One joint's impedance and torque:
//   torque = kp (position - q) + kd (velocity - dq) + feedforward.
struct MitTarget {
  int joint = 0;           // 0 .. 5
  double position = 0;     // [rad], -12.5 .. 12.5
  double velocity = 0;     // [rad/s], -45 .. 45
  double kp = 0;           // [Nm/rad], 0 .. 500
  double kd = 0;           // [Nm s/rad], -5 .. 5
  double feedforward = 0;  // [Nm], -8 .. 8
};
// Nothing when the check nibble (XOR of the bytes before it) is wrong.
std::optional<MitTarget> DecodeMitTarget(const CanFrame& frame);

// Joint angles within `limits` that bring the tool to p [m] and rpy [rad] (FixedAngles), from
// `start` by damped least squares; nothing when 0.1 mm and 0.1 mrad are not reached.
std::optional<JointVector> SolvePose(const Eigen::Vector3d& p, const Eigen::Vector3d& rpy,
                                     const JointVector& start,
                                     const std::array<Range, kJoints>& limits, Zero zero);

}  // namespace robostress::piper
