#include "robot_client/capsule.h"

#include <algorithm>

namespace robostress {

using Eigen::Vector3d;

namespace {

// Of a point from the box at the origin; negative: how deep. Convex.
double FromBox(const Vector3d& half, const Vector3d& point) {
  const Vector3d beyond = point.cwiseAbs() - half;
  const double outside = beyond.cwiseMax(0).norm();
  return outside > 0 ? outside : beyond.maxCoeff();
}

}  // namespace

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

double Distance(const Box& box, const Capsule& capsule) {
  const Eigen::Isometry3d T = box.T_base_box.inverse(Eigen::Isometry);
  const Vector3d from = T * capsule.from, way = T * capsule.to - from;
  const auto at = [&](double share) { return FromBox(box.half, from + share * way); };
  // A convex function along the segment: golden sections.
  constexpr double kGolden = 0.6180339887498949;
  double low = 0, high = 1, a = 1 - kGolden, b = kGolden, at_a = at(a), at_b = at(b);
  while ((high - low) * way.norm() > 1e-6) {
    if (at_a < at_b) {
      high = b, b = a, at_b = at_a;
      a = high - kGolden * (high - low), at_a = at(a);
    } else {
      low = a, a = b, at_a = at_b;
      b = low + kGolden * (high - low), at_b = at(b);
    }
  }
  return std::min({at(0), at(1), at_a, at_b}) - capsule.radius;
}

double Distance(const Capsule& a, const Capsule& b) {
  return SegmentDistance(a.from, a.to, b.from, b.to) - a.radius - b.radius;
}

}  // namespace robostress
