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

// 0x158: the pose that was sent before it is point 1, 2 or 3 of an arc: start, middle, end.
std::optional<int> DecodeArcPoint(const CanFrame& frame);

Eigen::Matrix3d FromFixedAngles(const Eigen::Vector3d& rpy);

// Joint angles within `limits` that bring the tool to p [m] and R, from `start` by damped least
// squares to within `tolerance` [m], [rad]; nothing when 0.1 mm and 0.1 mrad are not reached.
std::optional<JointVector> SolvePose(const Eigen::Vector3d& p, const Eigen::Matrix3d& R,
                                     const JointVector& start,
                                     const std::array<Range, kJoints>& limits, Zero zero,
                                     double tolerance = 1e-4);

// The same with roll, pitch, yaw (FixedAngles).
inline std::optional<JointVector> SolvePose(const Eigen::Vector3d& p, const Eigen::Vector3d& rpy,
                                            const JointVector& start,
                                            const std::array<Range, kJoints>& limits, Zero zero) {
  return SolvePose(p, FromFixedAngles(rpy), start, limits, zero);
}

}  // namespace robostress::piper
