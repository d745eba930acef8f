#include "robot_client/piper/kinematics.h"

#include <cmath>

namespace robostress::piper {
namespace {

constexpr double Radians(double degrees) { return degrees * M_PI / 180; }

std::array<DhRow, kJoints> Rows(double theta2, double theta3) {
  return {{{0, 0, 0.123, 0},
           {0, Radians(-90), 0, Radians(theta2)},
           {0.28503, 0, 0, Radians(theta3)},
           {-0.02198, Radians(90), 0.25075, 0},
           {0, Radians(-90), 0, 0},
           {0, Radians(90), 0.091, 0}}};
}

}  // namespace

const std::array<DhRow, kJoints>& DhRows(Zero zero) {
  static const auto before = Rows(-174.22, -100.78), since = Rows(-172.22, -102.78);
  return zero == Zero::kSince_1_6_3 ? since : before;
}

std::array<Eigen::Isometry3d, kJoints> LinkPoses(const JointVector& q, Zero zero) {
  const auto& rows = DhRows(zero);
  std::array<Eigen::Isometry3d, kJoints> poses;
  Eigen::Isometry3d T_base_link = Eigen::Isometry3d::Identity();
  for (int i = 0; i < kJoints; ++i) {
    const DhRow& row = rows[i];
    T_base_link = T_base_link * Eigen::AngleAxisd(row.alpha, Eigen::Vector3d::UnitX()) *
                  Eigen::Translation3d(row.a, 0, 0) *
                  Eigen::AngleAxisd(row.theta + q[i], Eigen::Vector3d::UnitZ()) *
                  Eigen::Translation3d(0, 0, row.d);
    poses[i] = T_base_link;
  }
  return poses;
}

Eigen::Matrix<double, 6, kJoints> ToolJacobian(const JointVector& q, Zero zero) {
  const std::array<Eigen::Isometry3d, kJoints> poses = LinkPoses(q, zero);
  Eigen::Matrix<double, 6, kJoints> J;
  for (int i = 0; i < kJoints; ++i) {
    const Eigen::Vector3d axis = poses[i].linear().col(2);
    J.col(i) << axis.cross(poses.back().translation() - poses[i].translation()), axis;
  }
  return J;
}

Eigen::Vector3d FixedAngles(const Eigen::Matrix3d& R) {
  // Closer to a pole than this, roll and yaw cannot be told apart in 0.001 degrees.
  constexpr double kPole = 1 - 1e-4;
  if (R(2, 0) < -kPole) return {std::atan2(R(0, 1), R(1, 1)), M_PI / 2, 0};
  if (R(2, 0) > kPole) return {-std::atan2(R(0, 1), R(1, 1)), -M_PI / 2, 0};
  return {std::atan2(R(2, 1), R(2, 2)), std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0))),
          std::atan2(R(1, 0), R(0, 0))};
}

}  // namespace robostress::piper
