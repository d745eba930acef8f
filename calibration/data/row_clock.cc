#include "calibration/data/row_clock.h"

#include <algorithm>
#include <cmath>

#include "calibration/data/measured_log.h"

namespace robostress::calibration {
namespace {

constexpr double kOff = 3;  // times the root mean square of what a curve is off by

// The polynomial through rows first ... last of (t, values) at `at`.
double Lagrange(const std::vector<double>& t, const std::vector<double>& values, size_t first,
                size_t last, double at) {
  double sum = 0;
  for (size_t a = first; a <= last; ++a) {
    double weight = 1;
    for (size_t b = first; b <= last; ++b)
      if (b != a) weight *= (at - t[b]) / (t[a] - t[b]);
    sum += weight * values[a];
  }
  return sum;
}

// Root mean square of what curves over gaps of `lost` rows are off by, in the middle of the gap.
double GapError(const std::vector<double>& channel, const std::vector<char>& absent, int lost) {
  const std::vector<double> t = {-1, 0, lost + 1.0, lost + 2.0};
  const int middle = (lost + 1) / 2, span = lost + 4;
  double sum = 0, count = 0;
  for (int first = 0; first + span <= static_cast<int>(channel.size()); ++first) {
    if (std::any_of(absent.begin() + first, absent.begin() + first + span,
                    [](char a) { return a != 0; }))
      continue;
    const std::vector<double> around = {channel[first], channel[first + 1],
                                        channel[first + lost + 2], channel[first + lost + 3]};
    const double off = Lagrange(t, around, 0, 3, middle) - channel[first + 1 + middle];
    sum += off * off, count += 1;
  }
  return count > 0 ? std::sqrt(sum / count) : 0;
}

}  // namespace

Resampling::Resampling(const std::vector<double>& t, const RowClock& clock) : t_(t) {
  size_t i = 0;
  for (int k = 0;; ++k) {
    const double at = t.front() + k * clock.dt;
    if (at > t.back() + 1e-6 * clock.dt) return;
    while (i + 2 < t.size() && t[i + 1] < at - RowClock::kJitter * clock.dt) ++i;
    before_.push_back(i);
    at_.push_back(at);
    const double nearest = std::min(std::abs(at - t[i]), std::abs(t[i + 1] - at));
    const bool none = t[i + 1] - t[i] > 1.5 * clock.dt && nearest > 0.5 * clock.dt;
    absent_.push_back(none ? MeasuredLog::kFilled : 0);
  }
}

std::vector<double> Resampling::Lines(const std::vector<double>& values) const {
  std::vector<double> result;
  for (size_t k = 0; k < at_.size(); ++k) {
    const size_t i = before_[k];
    const double share = std::clamp((at_[k] - t_[i]) / (t_[i + 1] - t_[i]), 0.0, 1.0);
    result.push_back(values[i] + share * (values[i + 1] - values[i]));
  }
  return result;
}

std::vector<double> Resampling::Curves(const std::vector<double>& values) const {
  std::vector<double> result;
  for (size_t k = 0; k < at_.size(); ++k) {
    const size_t i = before_[k], first = i > 0 ? i - 1 : i, last = std::min(i + 2, t_.size() - 1);
    result.push_back(Lagrange(t_, values, first, last, at_[k]));
  }
  return result;
}

void MarkGuesses(const std::vector<double>& channel, double noise, std::vector<char>& absent) {
  if (channel.size() != absent.size()) return;
  std::vector<double> errors;  // by rows that are lost
  for (size_t i = 0; i < absent.size(); ++i) {
    if (absent[i] == 0 || (i > 0 && absent[i - 1] != 0)) continue;
    size_t end = i;
    while (end < absent.size() && absent[end] != 0) ++end;
    const size_t lost = end - i;
    while (errors.size() <= lost)
      errors.push_back(GapError(channel, absent, static_cast<int>(errors.size())));
    if (kOff * errors[lost] > noise)
      std::fill(absent.begin() + static_cast<std::ptrdiff_t>(i),
                absent.begin() + static_cast<std::ptrdiff_t>(end), MeasuredLog::kGuessed);
  }
}

}  // namespace robostress::calibration
