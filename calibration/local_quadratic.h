#pragma once

#include <vector>

namespace robostress::calibration {

// Least-squares quadratic over `half` rows each side of every row (Savitzky and Golay 1964),
// one-sided at the ends: value, first and second derivative per row, and the standard deviation of
// the signal's noise, from its differences and its resolution.
struct LocalQuadratic {
  std::vector<double> value, first, second;
  double noise = 0;
  // Standard deviations of `value`, `first` and `second` that come of the noise.
  double value_noise = 0, first_noise = 0, second_noise = 0;
};
LocalQuadratic FitLocalQuadratics(const std::vector<double>& signal, double dt, int half);

// With the largest `half` up to `most` that leaves no more than noise: what is wider bends the
// motion.
LocalQuadratic SmoothMotion(const std::vector<double>& signal, double dt, int most);

}  // namespace robostress::calibration
