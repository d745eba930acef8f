#include "common/models/hull.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace robostress {
namespace {

using Eigen::Vector3d;

constexpr int kMostSteps = 64;
constexpr double kExact = 1e-7;  // [m] between what was found and what it cannot be below
constexpr double kMeet = 1e-9;   // [m]

const Vector3d& Furthest(const std::vector<Vector3d>& corners, const Vector3d& along) {
  const Vector3d* best = corners.data();
  double most = along.dot(*best);
  for (const Vector3d& corner : corners) {
    const double at = along.dot(corner);
    if (at > most) most = at, best = &corner;
  }
  return *best;
}

// Corners of a - b, and the ones whose hull has the point nearest to the origin.
struct Simplex {
  std::array<Vector3d, 4> corners;
  int count = 0;
  Vector3d nearest = Vector3d::Zero();
};

Simplex Of(const Vector3d& a) { return {{a}, 1, a}; }

Simplex Of(const Vector3d& a, const Vector3d& b) {
  const Vector3d ab = b - a;
  const double share = -a.dot(ab), whole = ab.squaredNorm();
  if (share <= 0 || !(whole > 0)) return Of(a);
  if (share >= whole) return Of(b);
  return {{a, b}, 2, a + share / whole * ab};
}

const Simplex& Nearer(const Simplex& a, const Simplex& b) {
  return b.nearest.squaredNorm() < a.nearest.squaredNorm() ? b : a;
}

Simplex Of(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  const Vector3d n = (b - a).cross(c - a);
  // Inside of all three edges, seen along the normal.
  if (n.squaredNorm() > 0 && a.cross(b).dot(n) >= 0 && b.cross(c).dot(n) >= 0 &&
      c.cross(a).dot(n) >= 0)
    return {{a, b, c}, 3, a.dot(n) / n.squaredNorm() * n};
  return Nearer(Nearer(Of(a, b), Of(b, c)), Of(a, c));
}

// A count of 4: the origin is inside.
Simplex Of(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d) {
  Simplex best{{a, b, c, d}, 4, Vector3d::Zero()};
  const auto face = [&](const Vector3d& p, const Vector3d& q, const Vector3d& r,
                        const Vector3d& other) {
    const Vector3d n = (q - p).cross(r - p);
    const double origin = -p.dot(n), inside = (other - p).dot(n);
    if (origin * inside > 0) return;
    const Simplex here = Of(p, q, r);
    best = best.count == 4 ? here : Nearer(best, here);
  };
  face(a, b, c, d);
  face(a, b, d, c);
  face(a, c, d, b);
  face(b, c, d, a);
  return best;
}

Simplex With(const Simplex& s, const Vector3d& w) {
  const auto& [a, b, c, d] = s.corners;
  switch (s.count) {
    case 1:
      return Of(a, w);
    case 2:
      return Of(a, b, w);
    default:
      return Of(a, b, c, w);
  }
}

// The least way out along some directions.
double Depth(const Hull& a, const Hull& b, const Eigen::Isometry3d& T_a_b) {
  Eigen::Matrix3d R_b_a = T_a_b.linear().transpose();
  double depth = std::numeric_limits<double>::infinity();
  const auto look = [&](const Vector3d& along) {
    const Vector3d in_b = R_b_a * along;
    const double way =
        along.dot(Furthest(a.corners, along)) - along.dot(T_a_b * Furthest(b.corners, -in_b));
    depth = std::min(depth, way);
  };
  for (int k = 0; k < 27; ++k) {
    const Vector3d direction(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
    if (k != 13) look(direction.normalized());
  }
  const Vector3d apart = T_a_b * b.corners.front() - a.corners.front();
  if (apart.norm() > kMeet) look(apart.normalized());
  return depth;
}

}  // namespace

// Gilbert, Johnson and Keerthi (1988), on the difference of the cores.
double Distance(const Hull& a, const Hull& b, const Eigen::Isometry3d& T_a_b, double enough) {
  const double radii = a.radius + b.radius;
  const Eigen::Matrix3d R_b_a = T_a_b.linear().transpose();
  Simplex simplex = Of(a.corners.front() - T_a_b * b.corners.front());
  for (int step = 0; step < kMostSteps; ++step) {
    const Vector3d& v = simplex.nearest;
    const double distance = v.norm();
    if (simplex.count == 4 || distance < kMeet) return -Depth(a, b, T_a_b) - radii;
    const Vector3d w = Furthest(a.corners, -v) - T_a_b * Furthest(b.corners, R_b_a * v);
    const double at_least = v.dot(w) / distance;
    if (at_least - radii > enough) return at_least - radii;
    if (distance - at_least < kExact) break;
    Simplex next = With(simplex, w);
    if (!(next.nearest.squaredNorm() < v.squaredNorm())) break;  // no nearer by rounding
    simplex = next;
  }
  return simplex.nearest.norm() - radii;
}

}  // namespace robostress
