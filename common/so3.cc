#include "common/so3.h"

#include <cmath>

namespace robostress {
namespace {

// Below this the series of sin(x)/x and its inverse are exact to double precision.
constexpr double kSmallAngle = 1e-6;

// At a half turn +axis and -axis are the same rotation; the first component that is clearly
// non-zero is made positive so that the answer is one of the two.
Eigen::Vector3d CanonicalAxis(const Eigen::Vector3d& axis) {
  for (int i = 0; i < 3; ++i) {
    if (std::abs(axis[i]) > 1e-9) return axis[i] > 0 ? axis : -axis;
  }
  return axis;
}

}  // namespace

Eigen::Quaterniond ExpSo3(const Eigen::Vector3d& omega) {
  const double angle = omega.norm();
  // sin(angle / 2) / angle
  const double k = angle < kSmallAngle ? 0.5 - angle * angle / 48.0 : std::sin(0.5 * angle) / angle;
  return {std::cos(0.5 * angle), k * omega.x(), k * omega.y(), k * omega.z()};
}

Eigen::Vector3d LogSo3(const Eigen::Quaterniond& q_in) {
  Eigen::Quaterniond q = q_in.normalized();
  if (q.w() < 0) q.coeffs() = -q.coeffs();  // short path
  const Eigen::Vector3d v = q.vec();
  const double sine = v.norm();
  if (sine < kSmallAngle) return 2.0 * v / q.w();
  const double angle = 2.0 * std::atan2(sine, q.w());
  const Eigen::Vector3d axis = v / sine;
  if (q.w() < 1e-12) return angle * CanonicalAxis(axis);
  return angle * axis;
}

Eigen::Vector3d LogSo3(const Eigen::Matrix3d& R) { return LogSo3(Eigen::Quaterniond(R)); }

Eigen::Vector3d RotationBetween(const Eigen::Quaterniond& from, const Eigen::Quaterniond& to) {
  return LogSo3(to * from.conjugate());
}

}  // namespace robostress
