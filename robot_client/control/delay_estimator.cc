#include "robot_client/control/delay_estimator.h"

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

constexpr double kMemory_s = 1;
// A joint at 0.1 rad/s for a third of a second, in ticks of 1/30 s.
constexpr double kLeastEnergy = 1e-4;
// Share of the measured motion that the best lag may leave unexplained.
constexpr double kMostUnexplained = 0.5;

}  // namespace

DelayEstimator::DelayEstimator(double period_s, int joints)
    : period_s_(period_s),
      joints_(joints),
      lags_(static_cast<int>(
          std::clamp(std::lround(kLongest_s / period_s) + 1, 3L, long{kMostLags}))),
      keep_(std::exp(-period_s / kMemory_s)) {}

void DelayEstimator::Reset() {
  first_ = true;
  next_ = seen_ = 0;
  energy_ = 0;
  error_.fill(0);
}

void DelayEstimator::Take(const ArmVector& command, const ArmVector& measured) {
  if (!std::exchange(first_, false)) {
    ArmVector& step = steps_[next_];
    for (int j = 0; j < joints_; ++j) step[j] = command[j] - last_command_[j];
    next_ = (next_ + 1) % kMostLags;
    seen_ = std::min(seen_ + 1, kMostLags);
    ArmVector moved{};
    double energy = 0;
    for (int j = 0; j < joints_; ++j) {
      moved[j] = measured[j] - last_measured_[j];
      energy += moved[j] * moved[j];
    }
    energy_ = keep_ * energy_ + energy;
    for (int lag = 0; lag < lags_; ++lag) {
      const ArmVector& then = steps_[(next_ - 1 - lag + 2 * kMostLags) % kMostLags];
      double error = 0;
      for (int j = 0; j < joints_; ++j) {
        const double sent = lag < seen_ ? then[j] : 0;
        error += (moved[j] - sent) * (moved[j] - sent);
      }
      error_[lag] = keep_ * error_[lag] + error;
    }
  }
  last_command_ = command;
  last_measured_ = measured;
}

std::optional<double> DelayEstimator::delay_s() const {
  if (energy_ < kLeastEnergy) return std::nullopt;
  const auto best = std::min_element(error_.begin(), error_.begin() + lags_);
  if (*best > kMostUnexplained * energy_) return std::nullopt;
  const auto lag = static_cast<int>(best - error_.begin());
  double between = 0;
  if (lag > 0 && lag + 1 < lags_) {
    const double before = error_[lag - 1], after = error_[lag + 1];
    const double bend = before - 2 * *best + after;
    if (bend > 0) between = std::clamp(0.5 * (before - after) / bend, -0.5, 0.5);
  }
  // The command of lag 0 was sent one tick before the measurement.
  return (lag + 1 + between) * period_s_;
}

}  // namespace robostress
