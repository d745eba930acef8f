#include "sim_worker/robosuite_rotation.h"

#include <algorithm>
#include <cmath>

namespace robostress {

Eigen::Matrix3d SinglePrecisionMatrix(const Eigen::Vector4d& wxyz) {
  Eigen::Vector4f q = wxyz.cast<float>();
  double sum = 0;  // of single-precision products, as OpenBLAS's sdot adds so short a vector
  for (const float element : q) sum += element * element;
  const float n = static_cast<float>(sum);
  const double scale = std::sqrt(2.0 / n);
  for (float& element : q) element = static_cast<float>(element * scale);
  const auto p = [&q](int i, int k) { return q[i] * q[k]; };
  const auto diagonal = [&p](int i, int k) {
    return 1.0 - static_cast<double>(p(i, i)) - static_cast<double>(p(k, k));
  };
  Eigen::Matrix3d R;
  R << diagonal(2, 3), p(1, 2) - p(3, 0), p(1, 3) + p(2, 0),  //
      p(1, 2) + p(3, 0), diagonal(1, 3), p(2, 3) - p(1, 0),   //
      p(1, 3) - p(2, 0), p(2, 3) + p(1, 0), diagonal(1, 2);
  return R;
}

Eigen::Vector3d AxisAngleAsRobosuite(const double* wxyz) {
  const double w = std::clamp(wxyz[0], -1.0, 1.0);
  const double sine = std::sqrt(1 - w * w);
  if (sine == 0) return Eigen::Vector3d::Zero();
  return Eigen::Vector3d(wxyz[1], wxyz[2], wxyz[3]) * (2 * std::acos(w) / sine);
}

}  // namespace robostress
