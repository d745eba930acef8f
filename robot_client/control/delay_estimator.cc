#include "robot_client/control/delay_estimator.h"

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

constexpr double kMemory_s = 1;
// A joint at 0.1 rad/s for a third of a second, in ticks of 1/30 s; half of it of one joint.
constexpr double kLeastEnergy = 1e-4;
// Share of the measured motion that the best lag may leave unexplained.
constexpr double kMostUnexplained = 0.5;
// Lags that are kBeside_s from the best must leave so much more of it unexplained: at constant
// speed every lag explains the steps alike, and the best is one by chance.
constexpr double kBeside_s = 1.0 / 15;
constexpr double kLeastWorse = 0.003;

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
  sums_.fill({});
}

void DelayEstimator::Take(const ArmVector& command, const ArmVector& measured) {
  if (!std::exchange(first_, false)) {
    ArmVector& step = steps_[next_];
    for (int j = 0; j < joints_; ++j) step[j] = command[j] - last_command_[j];
    next_ = (next_ + 1) % kMostLags;
    seen_ = std::min(seen_ + 1, kMostLags);
    Sums& all = sums_[static_cast<size_t>(joints_)];
    all = {};
    for (int j = 0; j < joints_; ++j) {
      Sums& sums = sums_[static_cast<size_t>(j)];
      const double moved = measured[j] - last_measured_[j];
      sums.energy = keep_ * sums.energy + moved * moved;
      all.energy += sums.energy;
      for (int lag = 0; lag < lags_; ++lag) {
        const ArmVector& then = steps_[(next_ - 1 - lag + 2 * kMostLags) % kMostLags];
        const double off = moved - (lag < seen_ ? then[j] : 0);
        sums.error[lag] = keep_ * sums.error[lag] + off * off;
        all.error[lag] += sums.error[lag];
      }
    }
  }
  last_command_ = command;
  last_measured_ = measured;
}

std::optional<double> DelayEstimator::delay_s() const {
  std::array<double, kMostAxes> delays;
  size_t found = 0;
  for (int j = 0; j < joints_; ++j) {
    if (const auto delay = DelayOf(sums_[static_cast<size_t>(j)], kLeastEnergy / 2))
      delays[found++] = *delay;
  }
  if (found == 0) return DelayOf(sums_[static_cast<size_t>(joints_)], kLeastEnergy);
  const auto median = delays.begin() + (found - 1) / 2;
  std::nth_element(delays.begin(), median, delays.begin() + found);
  return *median;
}

std::optional<double> DelayEstimator::DelayOf(const Sums& sums, double least_energy) const {
  if (sums.energy < least_energy) return std::nullopt;
  const auto best = std::min_element(sums.error.begin(), sums.error.begin() + lags_);
  if (*best > kMostUnexplained * sums.energy) return std::nullopt;
  const auto lag = static_cast<int>(best - sums.error.begin());
  const int beside = std::max(1, static_cast<int>(std::lround(kBeside_s / period_s_)));
  for (const int other : {lag - beside, lag + beside}) {
    if (other >= 0 && other < lags_ && sums.error[other] - *best < kLeastWorse * sums.energy)
      return std::nullopt;
  }
  double between = 0;
  if (lag > 0 && lag + 1 < lags_) {
    const double before = sums.error[lag - 1], after = sums.error[lag + 1];
    const double bend = before - 2 * *best + after;
    if (bend > 0) between = std::clamp(0.5 * (before - after) / bend, -0.5, 0.5);
  }
  // The command of lag 0 was sent one tick before the measurement.
  return (lag + 1 + between) * period_s_;
}

}  // namespace robostress
