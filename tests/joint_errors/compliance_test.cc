#include "common/joint_errors/compliance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

constexpr double kStep = 0.002;  // [s]

TEST(Compliance, SettlesAtTheStaticDeflectionAgainstTheLoad) {
  for (const JointErrorParameters& joint : NominalPandaErrors()) {
    Compliance compliance;
    compliance.Reset(0);
    double eta = 0;
    for (int i = 0; i < 500; ++i) eta = compliance.Step(joint, 10, kStep);
    EXPECT_NEAR(eta, -10 / joint.K, 1e-12);
    EXPECT_DOUBLE_EQ(Compliance::Equilibrium(joint, 10), -10 / joint.K);
  }
}

TEST(Compliance, StepResponseFollowsTheContinuousSystem) {
  // Largest difference to the closed form of the underdamped second-order system, as a share of the
  // static deflection: 10 % at 22.5 Hz and 2 ms (omega h = 0.28), less for the softer joints.
  for (const double w : {1.0, 5.0}) {
    for (const int j : {0, 6}) {
      const JointErrorParameters p = Scale(NominalPandaErrors()[j], {.compliance = w});
      const double omega = std::sqrt(p.K / p.M_eff), zeta = p.D / (2 * std::sqrt(p.K * p.M_eff));
      EXPECT_NEAR(zeta, 0.70, 1e-3);
      const double damped = omega * std::sqrt(1 - zeta * zeta);
      Compliance compliance;
      compliance.Reset(0);
      double worst = 0, peak = 0;
      for (int i = 1; i <= 250; ++i) {
        const double t = i * kStep;
        const double eta = compliance.Step(p, p.K, kStep);  // static deflection -1
        const double exact = -1 + std::exp(-zeta * omega * t) *
                                      (std::cos(damped * t) +
                                       zeta / std::sqrt(1 - zeta * zeta) * std::sin(damped * t));
        worst = std::max(worst, std::abs(eta - exact));
        peak = std::min(peak, eta);
      }
      EXPECT_LT(worst, 0.5 * omega * kStep) << "joint " << j + 1 << " w " << w;
      // Overshoot exp(-pi zeta / sqrt(1 - zeta^2)) = 4.6 %.
      EXPECT_NEAR(peak, -1.046, 0.03) << "joint " << j + 1 << " w " << w;
    }
  }
}

}  // namespace
}  // namespace robostress
