#include "sim_worker/libero/preprocess.h"

#include <algorithm>
#include <cmath>

namespace robostress::libero {

RenderOptions RenderAsLibero(int width, int height) {
  return {.width = width,
          .height = height,
          .shadows = true,
          .reflections = true,
          .samples = 4,
          .shadow_size = 4096};
}

Eigen::Vector3d AxisAngleAsLibero(const double* wxyz) {
  const double w = std::clamp(wxyz[0], -1.0, 1.0);
  const double sine = std::sqrt(1 - w * w);
  if (sine == 0) return Eigen::Vector3d::Zero();
  return Eigen::Vector3d(wxyz[1], wxyz[2], wxyz[3]) * (2 * std::acos(w) / sine);
}

}  // namespace robostress::libero
