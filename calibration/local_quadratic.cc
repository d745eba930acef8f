#include "calibration/local_quadratic.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace robostress::calibration {
namespace {

constexpr int kLeast = 2;      // rows each side
constexpr double kBent = 1.1;  // times the noise

// Weight of its own row in the value of a local quadratic.
double CenterLeverage(int half) {
  const double m = half;
  return 3 * (3 * m * m + 3 * m - 1) / ((2 * m - 1) * (2 * m + 1) * (2 * m + 3));
}

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
  const double m = half, squares = m * (m + 1) * (2 * m + 1) / 3;  // sum of i^2
  fit.value_noise = fit.noise * std::sqrt(CenterLeverage(half));
  fit.first_noise = fit.noise / (dt * std::sqrt(squares));
  return fit;
}

LocalQuadratic SmoothMotion(const std::vector<double>& signal, double dt, int most) {
  for (int half = most;; --half) {
    LocalQuadratic fit = FitLocalQuadratics(signal, dt, half);
    double sum = 0;
    for (size_t i = 0; i < signal.size(); ++i) sum += std::pow(signal[i] - fit.value[i], 2);
    const double left = std::sqrt(sum / static_cast<double>(signal.size()));
    if (half <= kLeast || left <= kBent * fit.noise * std::sqrt(1 - CenterLeverage(half)))
      return fit;
  }
}

}  // namespace robostress::calibration
