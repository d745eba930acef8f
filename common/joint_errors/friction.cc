#include "common/joint_errors/friction.h"

#include <algorithm>
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

void StickTorques(absl::Span<const double> v_free, absl::Span<const double> A,
                  absl::Span<const double> limit, absl::Span<double> f) {
  StickTorques(v_free, A, limit, limit, f);
}

void StickTorques(absl::Span<const double> v_free, absl::Span<const double> A,
                  absl::Span<const double> forward, absl::Span<const double> backward,
                  absl::Span<double> f) {
  const size_t n = v_free.size();
  std::fill(f.begin(), f.end(), 0.0);
  for (int sweep = 0; sweep < kStickSweeps; ++sweep) {
    double change = 0;
    for (size_t i = 0; i < n; ++i) {
      double v = v_free[i];
      for (size_t j = 0; j < n; ++j) v += A[i * n + j] * f[j];
      const double next = std::clamp(f[i] - v / A[i * n + i], -forward[i], backward[i]);
      change = std::max(change, std::abs(next - f[i]));
      f[i] = next;
    }
    if (change < 1e-9) break;
  }
}

}  // namespace robostress
