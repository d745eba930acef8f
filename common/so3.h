#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

// Rotations. Quaternions are Eigen's (constructor order w, x, y, z; stored x, y, z, w); arrays of
// four numbers are w, x, y, z as in MuJoCo.
namespace robostress {

// exp: axis-angle vector [rad] to rotation.
Eigen::Quaterniond ExpSo3(const Eigen::Vector3d& omega);
// log along the short path: |result| <= pi. At exactly pi the axis' first non-zero component is
// positive.
Eigen::Vector3d LogSo3(const Eigen::Quaterniond& q);
Eigen::Vector3d LogSo3(const Eigen::Matrix3d& R);
// Log(R_to R_from^-1): the world-frame rotation that takes `from` to `to` [rad].
Eigen::Vector3d RotationBetween(const Eigen::Quaterniond& from, const Eigen::Quaterniond& to);

}  // namespace robostress
