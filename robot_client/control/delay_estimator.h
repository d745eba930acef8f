#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <utility>

#include "robot_client/robot_arm.h"

namespace robostress {

// Estimates the time from a command to its motion in the measurement [s]: of all whole ticks the
// one at which the commands' steps explain the measured steps best, refined by a parabola through
// its neighbours. Steps, not positions, so that a joint that stands off its command by weight or
// backlash changes nothing. Older ticks are forgotten with a time constant of one second.
//
// It is asked of every joint that moves enough, and the (lower) median answers: what comes late in
// a bus or a driver makes all joints late, what sticks one of them. Where none moves enough alone,
// of all together.
//
// A delay that is constant breaks nothing at once and makes every correction wrong: it cannot be
// seen in ages of samples, which say when a frame came and not when it was made.
//
// Allocates nothing. One thread.
class DelayEstimator {
 public:
  static constexpr double kLongest_s = 0.6;

  DelayEstimator(double period_s, int joints);
  void Reset();
  // One tick: the command sent before it and the joints measured at its start.
  void Take(const ArmVector& command, const ArmVector& measured);
  // Nothing: the arm moved too little, or too evenly, to tell.
  std::optional<double> delay_s() const;

 private:
  static constexpr int kMostLags = 64;
  const double period_s_;
  const int joints_;
  const int lags_;
  const double keep_;                         // share of the sums that a tick keeps
  std::array<ArmVector, kMostLags> steps_{};  // of the commands, newest at next_ - 1
  int next_ = 0, seen_ = 0;
  ArmVector last_command_{}, last_measured_{};
  bool first_ = true;
  // Measured steps, and what a lag leaves of them unexplained [rad^2]; by joint, the last of all.
  struct Sums {
    double energy = 0;
    std::array<double, kMostLags> error{};
  };
  std::optional<double> DelayOf(const Sums& sums, double least_energy) const;
  std::array<Sums, kMostAxes + 1> sums_{};
};

}  // namespace robostress
