#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <limits>
#include <vector>

namespace robostress {

// All points within `radius` of the convex hull of `corners`: a ball has one corner, a capsule two.
struct Hull {
  std::vector<Eigen::Vector3d> corners;  // [m], at least one
  double radius = 0;                     // [m]
};

// Of the surfaces [m], to a micrometre. Where that is more than `enough`, some value above it that
// is not more: enough to know that another pair is nearer. Negative: how far one would have to move
// to be free, the radii included; more than that where the cores meet, of which 27 directions are
// tried. T_a_b: of b's frame in a's. Allocates nothing.
double Distance(const Hull& a, const Hull& b, const Eigen::Isometry3d& T_a_b,
                double enough = std::numeric_limits<double>::infinity());

}  // namespace robostress
