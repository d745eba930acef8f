#include "calibration/local_quadratic.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace robostress::calibration {
namespace {

constexpr int kOrders = 6;  // of differences

constexpr int kLeast = 2;      // rows each side
constexpr double kBent = 1.1;  // times the noise

// Weight of its own row in the value of a local quadratic.
double CenterLeverage(int half) {
  const double m = half;
  return 3 * (3 * m * m + 3 * m - 1) / ((2 * m - 1) * (2 * m + 1) * (2 * m + 3));
}

// Differences of order k of white noise have variance (2k over k) sigma^2. A motion adds to them,
// the less the higher the order, so the least is the best; their median hardly sees corners.
double NoiseOf(const std::vector<double>& signal) {
  std::vector<double> differences = signal;
  double least = std::numeric_limits<double>::infinity(), variance = 1;
  for (int order = 1; order <= kOrders && differences.size() > 1; ++order) {
    for (size_t i = 0; i + 1 < differences.size(); ++i)
      differences[i] = differences[i + 1] - differences[i];
    differences.pop_back();
    variance *= 2.0 * (2 * order - 1) / order;
    if (order < 3) continue;
    std::vector<double> sizes = differences;
    for (double& size : sizes) size = std::abs(size);
    const auto middle = sizes.begin() + static_cast<int>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    least = std::min(least, *middle / 0.6745 / std::sqrt(variance));
  }
  return std::isfinite(least) ? least : 0;
}

// The step of a reading that takes only multiples of one; 0 where there is none to be seen.
double ResolutionOf(std::vector<double> signal) {
  std::sort(signal.begin(), signal.end());
  const double range = signal.back() - signal.front();
  double step = range;
  std::vector<double> gaps;
  for (size_t i = 1; i < signal.size(); ++i) {
    const double gap = signal[i] - signal[i - 1];
    if (gap > 1e-9 * range) gaps.push_back(gap), step = std::min(step, gap);
  }
  if (gaps.empty()) return 0;
  const auto off = std::count_if(gaps.begin(), gaps.end(), [&](double gap) {
    return std::abs(gap / step - std::round(gap / step)) > 0.05;
  });
  return off * 50 < static_cast<int64_t>(gaps.size()) ? step : 0;
}

}  // namespace

LocalQuadratic FitLocalQuadratics(const std::vector<double>& signal, double dt, int half) {
  const int n = static_cast<int>(signal.size()), width = std::min(2 * half + 1, n);
  LocalQuadratic fit;
  fit.value.resize(n), fit.first.resize(n), fit.second.resize(n);
  // Of a reading in steps, at least that of the steps.
  fit.noise = std::max(NoiseOf(signal), ResolutionOf(signal) / std::sqrt(12.0));
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
  const double fourths = squares * (3 * m * m + 3 * m - 1) / 5;  // sum of i^4
  fit.second_noise =
      2 * fit.noise / (dt * dt * std::sqrt(fourths - squares * squares / (2 * m + 1)));
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
