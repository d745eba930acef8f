#pragma once

#include <Eigen/Core>

namespace robostress {

struct DisturbanceObserverOptions {
  double bandwidth = 2.0;        // omega_Q [1/s]
  double max_correction = 0.05;  // d_max [rad]
  double min_dt_s = 0.005;       // the elapsed control interval is clamped to this range [s]
  double max_dt_s = 0.2;
};

// The DOB baseline (paper, sec:supp_real): every joint servo is modelled as the identity, so the
// equivalent input disturbance is what the joint did beyond its last corrected target, seen through
// a first-order filter:
//
//   z <- z + (1 - exp(-omega_Q dt)) ((q - q_DOB_previous) - z)
//   q_DOB = q_ref - clip(z, -d_max, d_max)
//
// Runs in the control loop: allocates nothing. One thread.
class DisturbanceObserver {
 public:
  static constexpr int kMaxJoints = 8;
  using Joints = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1>;  // [rad]

  explicit DisturbanceObserver(const DisturbanceObserverOptions& options = {})
      : options_(options) {}

  void Reset();  // start of an episode
  // The corrected target to send, given the policy's target, the measured joints and the time since
  // the last call [s]. `q_ref` and `q` have the same size, at most kMaxJoints, equal in every call
  // between resets.
  Joints Correct(const Joints& q_ref, const Joints& q, double dt_s);
  const Joints& estimate() const { return z_; }  // before the clip; empty before the first call

 private:
  DisturbanceObserverOptions options_;
  Joints z_, last_target_;
};

}  // namespace robostress
