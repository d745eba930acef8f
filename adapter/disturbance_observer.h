#pragma once

#include <Eigen/Core>
#include <utility>

#include "adapter/joint_response.h"

namespace robostress {

struct DisturbanceObserverOptions {
  double bandwidth = 2.0;        // omega_Q [1/s]
  double max_correction = 0.05;  // d_max [rad]
  double min_dt_s = 0.005;       // the elapsed control interval is clamped to this range [s]
  double max_dt_s = 0.2;
  bool anti_windup = false;  // true: the state z itself is clipped, not only what is subtracted
  JointResponseOptions
      response;  // of a healthy arm; off: the paper's, whose servos are the identity

  template <class V>
  void Visit(V& v) {
    v.Field("bandwidth", bandwidth, "omega_Q of the disturbance filter [1/s]");
    v.Field("max_correction", max_correction, "d_max [rad]");
    v.Field("min_dt_s", min_dt_s, "least elapsed interval it reckons with [s]");
    v.Field("max_dt_s", max_dt_s, "most elapsed interval it reckons with [s]");
    v.Field("anti_windup", anti_windup,
            "clip the estimate itself, not only its use (paper: false)");
    v.Section("response", response, "how a healthy arm answers targets (paper: at once)");
  }
};

// Around the response of a healthy arm. Where the arm's own servos have an integral part it has to
// be several times slower than theirs (0.3 s on the emulated Piper): two that integrate the same
// offset overshoot. Impedance controllers have none, and leave it as fast as the delay lets it.
// Chosen on docs/results/arm-following.md's development states.
inline DisturbanceObserverOptions ObserverAround(JointResponseOptions response,
                                                 bool servo_integrates) {
  DisturbanceObserverOptions options;
  options.bandwidth = servo_integrates ? 0.5 : 4;
  options.max_correction = servo_integrates ? 0.05 : 0.1;
  options.anti_windup = true;
  options.response = std::move(response);
  return options;
}

// The DOB baseline (paper, sec:supp_real): every joint servo is modelled as the identity, so the
// equivalent input disturbance is what the joint did beyond its last corrected target, seen through
// a first-order filter:
//
//   z <- z + (1 - exp(-omega_Q dt)) ((q - q_DOB_previous) - z)
//   q_DOB = q_ref - clip(z, -d_max, d_max)
//
// The paper clips what is subtracted and lets z go on (anti_windup = false): after a long block z
// must run back first. With anti_windup z <- clip(z, -d_max, d_max) after every update.
//
// An arm lags, and a servo that is modelled as the identity counts its lag as disturbance: while
// the arm moves, z = -lag, and the target is sent ahead of a policy that learned to lead the arm
// itself. With `response` z is what the joint did beyond the motion that the sent targets make of a
// healthy arm, q_DOB_previous -> q_nominal (internal model control). A healthy arm then leaves z at
// 0, and a constant disturbance is taken off as before.
//
// Runs in the control loop: allocates nothing. One thread.
class DisturbanceObserver {
 public:
  static constexpr int kMaxJoints = 8;
  using Joints = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1>;  // [rad]

  explicit DisturbanceObserver(const DisturbanceObserverOptions& options = {})
      : options_(options), response_(options.response) {}

  void Reset();  // start of an episode
  // The corrected target to send, given the policy's target, the measured joints and the time since
  // the last measured call [s]. `q_ref` and `q` have the same size, at most kMaxJoints, equal in
  // every call between resets.
  Joints Correct(const Joints& q_ref, const Joints& q, double dt_s);
  // The same where no new measurement came, `dt_s` after the last call: the estimate of the last
  // update.
  Joints CorrectUnmeasured(const Joints& q_ref, double dt_s = 0);
  // The command that was really sent after Correct, where something behind the observer changed it:
  // the next update compares with this one.
  void Applied(const Joints& sent);
  const Joints& estimate() const { return z_; }  // before the clip; empty before the first call

 private:
  DisturbanceObserverOptions options_;
  // Where a healthy arm would be now, given `q` where it begins. dt_s since the last measurement.
  const Joints& Nominal(const Joints& q, double dt_s);

  JointResponse response_;
  double ahead_s_ = 0;  // that the response is ahead of the last measurement
  Joints z_, last_target_;
};

}  // namespace robostress
