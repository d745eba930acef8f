#include "robot_client/capsule.h"

#include <algorithm>

namespace robostress {

using Eigen::Vector3d;

double SegmentDistance(const Vector3d& a0, const Vector3d& a1, const Vector3d& b0,
                       const Vector3d& b1) {
  // Ericson, Real-Time Collision Detection, sec. 5.1.9.
  const Vector3d u = a1 - a0, v = b1 - b0, r = a0 - b0;
  const double a = u.squaredNorm(), e = v.squaredNorm(), f = v.dot(r), c = u.dot(r), b = u.dot(v);
  const double denominator = a * e - b * b;
  double s = denominator > 1e-15 ? std::clamp((b * f - c * e) / denominator, 0.0, 1.0) : 0.0;
  double t = e > 0 ? (b * s + f) / e : -1;
  if (t < 0 || t > 1) {
    t = std::clamp(t, 0.0, 1.0);
    s = a > 0 ? std::clamp((b * t - c) / a, 0.0, 1.0) : 0;
  }
  return (a0 + s * u - b0 - t * v).norm();
}

double Distance(const Capsule& a, const Capsule& b) {
  return SegmentDistance(a.from, a.to, b.from, b.to) - a.radius - b.radius;
}

}  // namespace robostress
