#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace robostress {

// All points within `radius` of a segment; a ball where its ends are one.
struct Capsule {
  Eigen::Vector3d from, to;  // [m]
  double radius = 0;         // [m]
};

// Distance of two segments [m].
double SegmentDistance(const Eigen::Vector3d& a0, const Eigen::Vector3d& a1,
                       const Eigen::Vector3d& b0, const Eigen::Vector3d& b1);

struct Box {
  Eigen::Isometry3d T_base_box = Eigen::Isometry3d::Identity();
  Eigen::Vector3d half = Eigen::Vector3d::Zero();  // of its sides [m]
};
// Of a capsule's surface from the box [m], to a micrometre; negative: how deep the capsule's
// segment is in the box, its radius added.
double Distance(const Box& box, const Capsule& capsule);

// Of their surfaces [m]; negative: how much less than both radii their segments are apart.
double Distance(const Capsule& a, const Capsule& b);

}  // namespace robostress
