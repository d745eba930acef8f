#include "calibration/data/local_polynomial.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "common/statistics.h"

namespace robostress::calibration {
namespace {

constexpr int kOrders = 6;  // of differences

// Differences of order k of white noise have variance (2k over k) sigma^2. A motion adds to them,
// the less the higher the order, so the least is the best; their median hardly sees corners.
// `moving`: only of rows among which the reading changes.
double NoiseOf(const std::vector<double>& signal, bool moving) {
  std::vector<double> differences = signal;
  double least = std::numeric_limits<double>::infinity(), variance = 1;
  for (int order = 1; order <= kOrders && differences.size() > 1; ++order) {
    for (size_t i = 0; i + 1 < differences.size(); ++i)
      differences[i] = differences[i + 1] - differences[i];
    differences.pop_back();
    variance *= 2.0 * (2 * order - 1) / order;
    if (order < 3) continue;
    std::vector<double> sizes;
    for (size_t i = 0; i < differences.size(); ++i) {
      const auto first = signal.begin() + static_cast<int64_t>(i);
      if (!moving ||
          std::any_of(first + 1, first + order + 1, [&](double v) { return v != *first; }))
        sizes.push_back(std::abs(differences[i]));
    }
    if (sizes.empty()) return 0;
    least = std::min(least, UpperMedian(std::move(sizes)) / 0.6745 / std::sqrt(variance));
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

// Rows of the pseudo-inverse of a polynomial around `place` of a window: weights of the value, the
// first and half the second derivative [order + 1, width].
Eigen::MatrixXd Weights(int width, int place, double dt, int order) {
  // In units of the width, so that high powers stay near one.
  const double unit = std::max(1, width / 2);
  Eigen::MatrixXd design(width, order + 1);
  for (int i = 0; i < width; ++i)
    for (int power = 0; power <= order; ++power)
      design(i, power) = std::pow((i - place) / unit, power);
  Eigen::MatrixXd weights = design.completeOrthogonalDecomposition().pseudoInverse();
  for (int power = 0; power <= order; ++power) weights.row(power) /= std::pow(unit * dt, power);
  return weights;
}

double MeanSquareDifference(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum / static_cast<double>(a.size());
}

// Adds to the standard deviations of `fit` what a fit of higher order and the same width changes
// beyond its noise; of nested least squares the variances of the noise subtract.
void AddBias(const SmoothSignal& higher, SmoothSignal& fit) {
  const auto add = [](const std::vector<double>& a, const std::vector<double>& b, double more,
                      double& own) {
    const double noise = more * more - own * own;
    own = std::sqrt(own * own + std::max(0.0, MeanSquareDifference(a, b) - noise));
  };
  add(higher.value, fit.value, higher.value_noise, fit.value_noise);
  add(higher.first, fit.first, higher.first_noise, fit.first_noise);
  add(higher.second, fit.second, higher.second_noise, fit.second_noise);
}

}  // namespace

double NoiseOfReading(const std::vector<double>& signal) {
  // Of a reading in steps, at least that of the steps.
  const double noise = std::max(NoiseOf(signal, false), ResolutionOf(signal) / std::sqrt(12.0));
  // A joint that stands for most of a log repeats its reading, which hides the noise.
  return noise > 0 ? noise : NoiseOf(signal, true);
}

SmoothSignal FitLocalPolynomials(const std::vector<double>& signal, double dt, int half, int order,
                                 double noise, const std::vector<int>& pieces) {
  const size_t n = signal.size();
  SmoothSignal fit;
  fit.value.resize(n), fit.first.resize(n), fit.second.resize(n);
  std::map<std::pair<int, int>, Eigen::MatrixXd> weights;  // by width and place
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();
  for (size_t piece = 0; piece + 1 < pieces.size(); ++piece) {
    const int begin = pieces[piece], end = pieces[piece + 1];
    const int width = std::min(2 * half + 1, end - begin);
    for (int i = begin; i < end; ++i) {
      const int first = std::clamp(i - width / 2, begin, end - width), place = i - first;
      Eigen::MatrixXd& own = weights[{width, place}];
      if (own.size() == 0) own = Weights(width, place, dt, std::min(order, width - 1));
      const int known = std::min<int>(3, static_cast<int>(own.rows()));
      Eigen::Vector3d c = Eigen::Vector3d::Zero();
      c.head(known) =
          own.topRows(known) * Eigen::Map<const Eigen::VectorXd>(signal.data() + first, width);
      variance.head(known) += own.topRows(known).rowwise().squaredNorm();
      fit.value[i] = c[0];
      fit.first[i] = c[1];
      fit.second[i] = 2 * c[2];
    }
  }
  const Eigen::Vector3d deviation = noise * (variance / static_cast<double>(n)).cwiseSqrt();
  fit.value_noise = deviation[0];
  fit.first_noise = deviation[1];
  fit.second_noise = 2 * deviation[2];
  return fit;
}

SmoothSignal SmoothMotion(const std::vector<double>& signal, double dt, int most,
                          std::vector<int> pieces) {
  if (pieces.empty()) pieces = {0, static_cast<int>(signal.size())};
  const double noise = NoiseOfReading(signal);
  SmoothSignal best;
  best.first_noise = best.second_noise = std::numeric_limits<double>::infinity();
  for (int half = 2; half <= most; half += 1 + half / 6) {
    std::vector<SmoothSignal> orders;
    for (int order = 2; order <= std::min(6, 2 * half); order += 2)
      orders.push_back(FitLocalPolynomials(signal, dt, half, order, noise, pieces));
    for (size_t i = 0; i + 1 < orders.size(); ++i) {
      SmoothSignal& fit = orders[i];
      AddBias(orders[i + 1], fit);
      if (fit.second_noise < best.second_noise) {
        best.second_noise = fit.second_noise;
        best.second = fit.second;
      }
      if (fit.first_noise < best.first_noise) {
        best.value_noise = fit.value_noise;
        best.first_noise = fit.first_noise;
        best.value = std::move(fit.value);
        best.first = std::move(fit.first);
      }
    }
  }
  return best;
}

}  // namespace robostress::calibration
