#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

#include "common/robot_description.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// Where the joints' zeros stand: firmware S-V1.6-3 moved those of J2 and J3 by two degrees.
// NOLINTNEXTLINE(readability-identifier-naming): a version with its dots
enum class Zero { kBefore_1_6_3, kSince_1_6_3 };

// Modified Denavit-Hartenberg parameters (Craig, Introduction to Robotics, sec. 3.4), the SDK's
// numbers (kinematics/piper_fk.py):
//   T_(i-1)_i = Rot_x(alpha_i) Trans_x(a_i) Rot_z(theta_i + q_i) Trans_z(d_i).
struct DhRow {
  double a, alpha, d, theta;  // [m], [rad], [m], [rad]
};
const std::array<DhRow, kJoints>& DhRows(Zero zero);

// T_base_link1 .. T_base_link6; the last is the SDK's tool frame, in the gripper's flange [m].
std::array<Eigen::Isometry3d, kJoints> LinkPoses(const JointVector& q, Zero zero);
inline Eigen::Isometry3d ToolPose(const JointVector& q, Zero zero) {
  return LinkPoses(q, zero).back();
}

// (v, w) = J dq of the tool frame's origin, base frame [m/s, rad/s].
Eigen::Matrix<double, 6, kJoints> ToolJacobian(const JointVector& q, Zero zero);

// Roll, pitch, yaw [rad] about the fixed axes x, y, z as the arm reports them:
// R = Rot_z(yaw) Rot_y(pitch) Rot_x(roll), pitch in [-pi/2, pi/2]; at its ends yaw is zero.
Eigen::Vector3d FixedAngles(const Eigen::Matrix3d& R);

// Of what it may be told [rad], as its description says.
struct Range {
  double lower, upper;
};
inline constexpr std::array<Range, kJoints> kJointRanges = [] {
  std::array<Range, kJoints> ranges{};
  for (int j = 0; j < kJoints; ++j) ranges[j] = {kPiper.joints[j].lower, kPiper.joints[j].upper};
  return ranges;
}();
// Mechanical stops [rad], beyond the limits (github.com/Reimagine-Robotics/piper_control, pull
// requests 76 and 78).
inline constexpr std::array<Range, kJoints> kJointStops = {
    {{-2.687, 2.687}, {0, 3.403}, {-3.054, 0}, {-1.85, 1.85}, {-1.309, 1.309}, {-2.967, 2.967}}};
inline constexpr double kMaxJointSpeed = kPiper.joints[0].max_velocity;                // [rad/s]
inline constexpr double kMaxJointAcceleration = kPiper.joints[0].max_acceleration;     // [rad/s^2]
constexpr double TorqueLimit(int joint) { return kPiper.joints[joint].torque_limit; }  // [Nm]
inline constexpr double kGripperOpening = 0.07;  // [m], the 70 mm gripper

}  // namespace robostress::piper
