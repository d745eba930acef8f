#include "common/joint_errors/stick_friction.h"

#include <cmath>

namespace robostress {

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
