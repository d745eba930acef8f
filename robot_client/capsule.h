#pragma once

#include <Eigen/Core>

namespace robostress {

// All points within `radius` of a segment; a ball where its ends are one.
struct Capsule {
  Eigen::Vector3d from, to;  // [m]
  double radius = 0;         // [m]
};

// Distance of two segments [m].
double SegmentDistance(const Eigen::Vector3d& a0, const Eigen::Vector3d& a1,
                       const Eigen::Vector3d& b0, const Eigen::Vector3d& b1);

// Of their surfaces [m]; negative: how much less than both radii their segments are apart.
double Distance(const Capsule& a, const Capsule& b);

}  // namespace robostress
