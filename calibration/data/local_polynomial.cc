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

// Least squares of a polynomial over `width` rows: its value, first and half its second derivative
// at any of them.
class WindowFit {
 public:
  WindowFit(int width, double dt, int order)
      : width_(width), unit_(std::max(1, width / 2)), per_time_(1 / (unit_ * dt)) {
    // In units of the width about its middle, so that high powers stay near one.
    Eigen::MatrixXd design(width, order + 1);
    for (int i = 0; i < width; ++i) design.row(i) = Powers(i, order + 1).row(0);
    const Eigen::HouseholderQR<Eigen::MatrixXd> qr(design);
    const Eigen::MatrixXd Q = qr.householderQ() * Eigen::MatrixXd::Identity(width, order + 1);
    coefficients_ =
        qr.matrixQR().topRows(order + 1).triangularView<Eigen::Upper>().solve(Q.transpose());
    covariance_ = coefficients_ * coefficients_.transpose();
    middle_ = Powers(width / 2, order + 1) * coefficients_;
  }

  // Of the rows from `first` on.
  Eigen::VectorXd Coefficients(const double* first) const {
    return coefficients_ * Eigen::Map<const Eigen::VectorXd>(first, width_);
  }
  Eigen::Vector3d At(const Eigen::VectorXd& coefficients, int place) const {
    return Powers(place, static_cast<int>(coefficients.size())) * coefficients;
  }
  // At row width / 2.
  Eigen::Vector3d AtMiddle(const double* first) const {
    return middle_ * Eigen::Map<const Eigen::VectorXd>(first, width_);
  }
  // Of noise of variance 1.
  Eigen::Vector3d Variance(int place) const {
    const Eigen::MatrixXd powers = Powers(place, static_cast<int>(covariance_.rows()));
    return (powers * covariance_).cwiseProduct(powers).rowwise().sum();
  }

 private:
  // Of a place's distance from the middle, and of their derivatives by time [3, count].
  Eigen::Matrix<double, 3, Eigen::Dynamic> Powers(int place, int count) const {
    const double x = (place - 0.5 * (width_ - 1)) / unit_;
    Eigen::Matrix<double, 3, Eigen::Dynamic> powers(3, count);
    powers.setZero();
    double power = 1;  // x^(k - 2)
    for (int k = 0; k < count; ++k) {
      if (k < 2) {
        powers(0, k) = k == 0 ? 1 : x;
        powers(1, k) = k * per_time_;
        continue;
      }
      powers(0, k) = power * x * x;
      powers(1, k) = k * power * x * per_time_;
      powers(2, k) = 0.5 * k * (k - 1) * power * per_time_ * per_time_;
      power *= x;
    }
    return powers;
  }

  int width_;
  double unit_, per_time_;
  Eigen::MatrixXd coefficients_;  // [order + 1, width]
  Eigen::MatrixXd covariance_;    // [order + 1, order + 1]
  Eigen::Matrix<double, 3, Eigen::Dynamic> middle_;
};

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
  std::map<int, WindowFit> windows;  // by width
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();
  for (size_t piece = 0; piece + 1 < pieces.size(); ++piece) {
    const int begin = pieces[piece], end = pieces[piece + 1];
    const int width = std::min(2 * half + 1, end - begin);
    if (width < 1) continue;
    const WindowFit& window =
        windows.try_emplace(width, width, dt, std::min(order, width - 1)).first->second;
    const Eigen::Vector3d middle = window.Variance(width / 2);
    const auto put = [&](int i, const Eigen::Vector3d& c) {
      fit.value[i] = c[0];
      fit.first[i] = c[1];
      fit.second[i] = 2 * c[2];
    };
    // The rows of an end share one window.
    const auto put_end = [&](int first, int from, int to) {
      if (from >= to) return;
      const Eigen::VectorXd c = window.Coefficients(signal.data() + first);
      for (int i = from; i < to; ++i) {
        put(i, window.At(c, i - first));
        variance += window.Variance(i - first);
      }
    };
    const int last = end - width;
    put_end(begin, begin, begin + width / 2);
    for (int first = begin; first <= last; ++first) {
      put(first + width / 2, window.AtMiddle(signal.data() + first));
      variance += middle;
    }
    put_end(last, last + width / 2 + 1, end);
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
