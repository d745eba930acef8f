#pragma once

#include <cmath>

#include "common/joint_errors/scenarios.h"

namespace robostress {

// Position stage: spring-mass-damper deflection of the transmission (paper, Eq. compliance),
//   M_eff eta'' + D eta' + K eta = -tau_load,
// eta = eta_comp [rad], tau_load [Nm] the same sub-step's perturbed torque. Integrated exactly for
// a load and parameters that are constant over a sub-step: with delta = eta + tau_load / K, alpha =
// D / (2 M_eff), omega^2 = K / M_eff,
//   delta(h) = e^(-alpha h) ((C + alpha S) delta + S eta'),
//   eta'(h)  = e^(-alpha h) ((C - alpha S) eta' - omega^2 S delta),
// C = cos(w h), S = sin(w h) / w, w^2 = omega^2 - alpha^2; hyperbolic where w^2 < 0. The response
// has frequency and damping of the equation at every step size.
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
    if (p.M_eff != M_eff_ || p.D != D_ || p.K != K_ || h != h_) Discretise(p, h);
    const double rest = Equilibrium(p, tau_load), delta = deflection_ - rest;
    deflection_ = rest + delta_delta_ * delta + delta_rate_ * rate_;
    rate_ = rate_delta_ * delta + rate_rate_ * rate_;
    return deflection_;
  }
  double deflection() const { return deflection_; }  // [rad]
  double rate() const { return rate_; }              // [rad/s]

 private:
  void Discretise(const JointErrorParameters& p, double h) {
    M_eff_ = p.M_eff, D_ = p.D, K_ = p.K, h_ = h;
    const double alpha = p.D / (2 * p.M_eff), omega2 = p.K / p.M_eff;
    const double w2 = omega2 - alpha * alpha, w = std::sqrt(std::abs(w2));
    double decay = std::exp(-alpha * h), C = 1, S = h;
    if (w2 > 0) {
      C = std::cos(w * h);
      S = std::sin(w * h) / w;
    } else if (w > 0) {
      // Times e^(-alpha h), without which a stiff one overflows; alpha - w = omega^2 / (alpha + w).
      const double slow = std::exp(-omega2 / (alpha + w) * h);
      C = 0.5 * slow * (1 + std::exp(-2 * w * h));
      S = 0.5 * slow * -std::expm1(-2 * w * h) / w;
      decay = 1;
    }
    delta_delta_ = decay * (C + alpha * S);
    delta_rate_ = decay * S;
    rate_delta_ = -decay * omega2 * S;
    rate_rate_ = decay * (C - alpha * S);
  }

  double deflection_ = 0, rate_ = 0;
  double M_eff_ = 0, D_ = 0, K_ = 0, h_ = 0;  // of the transition matrix below
  double delta_delta_ = 1, delta_rate_ = 0, rate_delta_ = 0, rate_rate_ = 1;
};

}  // namespace robostress
