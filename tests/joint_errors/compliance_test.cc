#include "common/joint_errors/compliance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

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

constexpr double kFactors[] = {1, 2, 2.75, 3.5, 4.25, 5};  // nominal and L1 .. L5

// Deflections after 1, 2, .. n steps of h [s] from rest under the load -K: the static deflection
// is 1.
std::vector<double> StepResponse(const JointErrorParameters& p, double h, int n) {
  Compliance compliance;
  compliance.Reset(0);
  std::vector<double> eta;
  for (int i = 0; i < n; ++i) eta.push_back(compliance.Step(p, -p.K, h));
  return eta;
}

TEST(Compliance, StepResponseFollowsTheContinuousSystemAtEveryJointAndSeverity) {
  // The closed form of the underdamped second-order system. The integration is of first order: the
  // largest difference is within half of omega h, which is 14 % at 22.5 Hz and 2 ms.
  for (const JointErrorParameters& nominal : NominalPandaErrors()) {
    for (const double w : kFactors) {
      const JointErrorParameters p = Scale(nominal, {.compliance = w});
      const double omega = std::sqrt(p.K / p.M_eff), zeta = p.D / (2 * std::sqrt(p.K * p.M_eff));
      const double damped = omega * std::sqrt(1 - zeta * zeta);
      for (const double h : {kStep, kStep / 10, kStep / 100}) {
        double worst = 0, t = 0;
        for (const double eta : StepResponse(p, h, static_cast<int>(0.3 / h))) {
          t += h;
          const double exact = 1 - std::exp(-zeta * omega * t) *
                                       (std::cos(damped * t) +
                                        zeta / std::sqrt(1 - zeta * zeta) * std::sin(damped * t));
          worst = std::max(worst, std::abs(eta - exact));
        }
        EXPECT_LT(worst, 0.5 * omega * h) << "K " << p.K << " h " << h;
      }
    }
  }
}

TEST(Compliance, MeasuredFrequencyAndDampingAreThePapersAtEverySeverity) {
  // Read off the response at steps of 10 us: overshoot exp(-pi zeta / sqrt(1 - zeta^2)) at the time
  // 1 / (2 f sqrt(1 - zeta^2)).
  constexpr double kFine = 1e-5;  // [s]
  for (int j = 0; j < 7; ++j) {
    for (const double w : kFactors) {
      const JointErrorParameters p = Scale(NominalPandaErrors()[j], {.compliance = w});
      const std::vector<double> eta = StepResponse(p, kFine, 15000);
      const auto peak = std::max_element(eta.begin(), eta.end());
      const double decay = -std::log(*peak - 1), zeta = decay / std::hypot(M_PI, decay);
      const double peak_time = kFine * static_cast<double>(peak - eta.begin() + 1);
      const double f = 1 / (2 * peak_time * std::sqrt(1 - zeta * zeta));
      EXPECT_NEAR(zeta, 0.70, 0.002) << "joint " << j + 1 << " w " << w;
      EXPECT_NEAR(f * std::sqrt(w), j < 4 ? 14.7 : 22.5, 0.05) << "joint " << j + 1 << " w " << w;
      EXPECT_DOUBLE_EQ(p.D * std::sqrt(w), NominalPandaErrors()[j].D);
    }
  }
}

TEST(Compliance, AtTwoMillisecondsItIsTheExactSolutionOfTheRecurrence) {
  // With a = omega h the distance e to the static deflection obeys
  //   e_k+1 = (2 - 2 zeta a - a^2) e_k - (1 - 2 zeta a) e_k-1,  e_0 = e_-1 = -1,
  // hence e_k = rho^k (A cos k theta + B sin k theta), rho^2 = 1 - 2 zeta a < 1.
  for (const JointErrorParameters& nominal : NominalPandaErrors()) {
    for (const double w : kFactors) {
      const JointErrorParameters p = Scale(nominal, {.compliance = w});
      const double a = std::sqrt(p.K / p.M_eff) * kStep, damping = p.D * kStep / p.M_eff;
      const double rho = std::sqrt(1 - damping);
      const double theta = std::acos((2 - damping - a * a) / (2 * rho));
      const double B = (a * a - 1 + rho * std::cos(theta)) / (rho * std::sin(theta));
      int k = 0;
      for (const double eta : StepResponse(p, kStep, 150)) {
        ++k;
        EXPECT_NEAR(eta, 1 + std::pow(rho, k) * (-std::cos(k * theta) + B * std::sin(k * theta)),
                    1e-12);
      }
    }
  }
}

TEST(Compliance, AReleasedDeflectionNeverGrowsAndDiesOut) {
  for (const JointErrorParameters& nominal : NominalPandaErrors()) {
    for (const double w : kFactors) {
      const JointErrorParameters p = Scale(nominal, {.compliance = w});
      Compliance compliance;
      compliance.Reset(1);
      for (int i = 0; i < 250; ++i) EXPECT_LT(std::abs(compliance.Step(p, 0, kStep)), 1);
      EXPECT_LT(std::abs(compliance.deflection()), 1e-6);
    }
  }
}

}  // namespace
}  // namespace robostress
