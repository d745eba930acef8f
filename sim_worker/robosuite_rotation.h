#pragma once

#include <Eigen/Core>

namespace robostress {

// Matrix of a quaternion w x y z as robosuite 1.4.0 computes it (utils/transform_utils.py,
// quat2mat): the quaternion and its outer product in single precision, the diagonal in double.
Eigen::Matrix3d SinglePrecisionMatrix(const Eigen::Vector4d& wxyz);

}  // namespace robostress
