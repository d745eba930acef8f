#pragma once

#include "common/joint_errors/scenarios.h"

namespace robostress {

// Position stage: the Tao-Kokotovic deadband (paper, Eq. backlash). The link angle q_l follows the
// motor angle q_m only when it pushes against a side of the gap of half-width B [rad]:
//   q_l(t) = q_m - B  if q_m - q_l(t-1) > B;   q_m + B  if q_m - q_l(t-1) < -B;   q_l(t-1)
//   otherwise, eta_back = q_l(t) - q_m(t),  |eta_back| <= B.
// q_m is the joint coordinate minus the offset that it carries, not the joint coordinate.
class Backlash {
 public:
  // Mid-gap: the link where the motor is.
  void Reset(double q_motor) { q_link_ = q_motor; }
  // One sub-step; returns eta_back [rad].
  double Step(const JointErrorParameters& p, double q_motor) {
    if (q_motor - q_link_ > p.B) {
      q_link_ = q_motor - p.B;
    } else if (q_motor - q_link_ < -p.B) {
      q_link_ = q_motor + p.B;
    }
    return q_link_ - q_motor;
  }
  double link_angle() const { return q_link_; }

 private:
  double q_link_ = 0;  // [rad]
};

}  // namespace robostress
