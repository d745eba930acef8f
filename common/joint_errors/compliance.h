#pragma once

#include "common/joint_errors/scenarios.h"

namespace robostress {

// Position stage: spring-mass-damper deflection of the transmission (paper, Eq. compliance),
//   M_eff eta'' + D eta' + K eta = -tau_load,
// eta = eta_comp [rad], tau_load [Nm] the same sub-step's perturbed torque. Integrated with
// semi-implicit Euler:
//   eta' += h (-tau_load - D eta' - K eta) / M_eff,   eta += h eta',
// stable while K h^2 + 2 D h < 4 M_eff; at h = 2 ms the left side is at most 0.22 of the right one.
class Compliance {
 public:
  void Reset(double deflection) {
    deflection_ = deflection;
    rate_ = 0;
  }
  // The static deflection under a constant load [rad].
  static double Equilibrium(const JointErrorParameters& p, double tau_load) {
    return -tau_load / p.K;
  }
  // One sub-step of h [s]; returns eta_comp [rad].
  double Step(const JointErrorParameters& p, double tau_load, double h) {
    rate_ += h * (-tau_load - p.D * rate_ - p.K * deflection_) / p.M_eff;
    deflection_ += h * rate_;
    return deflection_;
  }
  double deflection() const { return deflection_; }

 private:
  double deflection_ = 0;  // [rad]
  double rate_ = 0;        // [rad/s]
};

}  // namespace robostress
