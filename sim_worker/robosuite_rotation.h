#pragma once

#include <Eigen/Core>

namespace robostress {

// Matrix of a quaternion w x y z as robosuite 1.4.0 computes it (utils/transform_utils.py,
// quat2mat): the quaternion and its outer product in single precision, the diagonal in double.
Eigen::Matrix3d SinglePrecisionMatrix(const Eigen::Vector4d& wxyz);

// A quaternion w x y z as axis times angle [rad], the angle in [0, 2 pi]: robosuite's
// quat2axisangle, which openpi's client and LIBERO's recordings use. Not the short way round where
// w < 0; zero where |w| = 1.
Eigen::Vector3d AxisAngleAsRobosuite(const double* wxyz);

}  // namespace robostress
