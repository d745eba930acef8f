#include "common/joint_errors/effects/friction.h"

#include <cmath>

namespace robostress {

double StribeckMagnitude(const JointErrorParameters& p, double dq) {
  const double ratio = dq / p.vs;
  return p.Fc + (p.Fs - p.Fc) * std::exp(-ratio * ratio);
}

double StribeckTorque(const JointErrorParameters& p, double dq, FrictionLaw law,
                      double tanh_width) {
  const double direction = law == FrictionLaw::kTanh ? std::tanh(dq / tanh_width)
                                                     : static_cast<double>((dq > 0) - (dq < 0));
  return -direction * StribeckMagnitude(p, dq) - p.sigma_v * dq;
}

}  // namespace robostress
