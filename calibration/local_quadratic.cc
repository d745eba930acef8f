#include "calibration/local_quadratic.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace robostress::calibration {
namespace {

// Third differences of white noise have variance 20 sigma^2 and hardly see a smooth motion; the
// median hardly sees its corners.
double NoiseOf(const std::vector<double>& signal) {
  std::vector<double> differences;
  for (size_t i = 3; i < signal.size(); ++i)
    differences.push_back(
        std::abs(signal[i] - 3 * signal[i - 1] + 3 * signal[i - 2] - signal[i - 3]));
  if (differences.empty()) return 0;
  const auto middle = differences.begin() + differences.size() / 2;
  std::nth_element(differences.begin(), middle, differences.end());
  return *middle / 0.6745 / std::sqrt(20.0);
}

}  // namespace

LocalQuadratic FitLocalQuadratics(const std::vector<double>& signal, double dt, int half) {
  const int n = static_cast<int>(signal.size()), width = std::min(2 * half + 1, n);
  LocalQuadratic fit;
  fit.value.resize(n), fit.first.resize(n), fit.second.resize(n);
  fit.noise = NoiseOf(signal);
  Eigen::MatrixXd design(width, 3);
  // Rows of the pseudo-inverse, evaluated at each place within the window.
  const auto weights_at = [&](int place) {
    for (int i = 0; i < width; ++i) {
      const double x = (i - place) * dt;
      design.row(i) << 1, x, x * x;
    }
    return Eigen::MatrixXd(design.completeOrthogonalDecomposition().pseudoInverse());  // [3, width]
  };
  std::vector<Eigen::MatrixXd> weights(width);
  for (int i = 0; i < n; ++i) {
    const int first = std::clamp(i - width / 2, 0, n - width), place = i - first;
    if (weights[place].size() == 0) weights[place] = weights_at(place);
    const Eigen::Map<const Eigen::VectorXd> window(signal.data() + first, width);
    const Eigen::Vector3d c = weights[place] * window;
    fit.value[i] = c[0];
    fit.first[i] = c[1];
    fit.second[i] = 2 * c[2];
  }
  return fit;
}

}  // namespace robostress::calibration
