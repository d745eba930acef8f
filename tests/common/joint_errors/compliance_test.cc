#include "common/joint_errors/effects/compliance.h"

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

TEST(Compliance, StepResponseIsTheContinuousSystemsAtEveryJointSeverityAndStepSize) {
  for (const JointErrorParameters& nominal : NominalPandaErrors()) {
    for (const double w : kFactors) {
      const JointErrorParameters p = Scale(nominal, {.compliance = w});
      const double omega = std::sqrt(p.K / p.M_eff), zeta = p.D / (2 * std::sqrt(p.K * p.M_eff));
      const double damped = omega * std::sqrt(1 - zeta * zeta);
      for (const double h : {5 * kStep, kStep, kStep / 10}) {
        double t = 0;
        for (const double eta : StepResponse(p, h, static_cast<int>(0.3 / h))) {
          t += h;
          const double exact = 1 - std::exp(-zeta * omega * t) *
                                       (std::cos(damped * t) +
                                        zeta / std::sqrt(1 - zeta * zeta) * std::sin(damped * t));
          ASSERT_NEAR(eta, exact, 1e-12) << "K " << p.K << " h " << h << " t " << t;
        }
      }
    }
  }
}

TEST(Compliance, AgreesWithRungeKuttaUnderALoadAndParametersThatChange) {
  // Fourth order at 20 us, 100 steps in a sub-step; loads and softening (Heavy Payload) change
  // between sub-steps. Also over- and critically damped.
  for (const double damping : {0.3, 1.0, 2.0}) {
    Compliance compliance;
    compliance.Reset(0.001);
    double eta = 0.001, rate = 0;
    for (int i = 0; i < 200; ++i) {
      JointErrorParameters p = Scale(NominalPandaErrors()[0], {.compliance = 1 + 0.02 * i});
      p.D = 2 * damping * std::sqrt(p.K * p.M_eff);
      const double load = 20 * std::sin(0.1 * i);
      const auto acceleration = [&](double e, double v) {
        return (-load - p.D * v - p.K * e) / p.M_eff;
      };
      constexpr double kFine = kStep / 100;
      for (int k = 0; k < 100; ++k) {
        const double a1 = acceleration(eta, rate);
        const double v2 = rate + kFine / 2 * a1, a2 = acceleration(eta + kFine / 2 * rate, v2);
        const double v3 = rate + kFine / 2 * a2, a3 = acceleration(eta + kFine / 2 * v2, v3);
        const double v4 = rate + kFine * a3, a4 = acceleration(eta + kFine * v3, v4);
        eta += kFine / 6 * (rate + 2 * v2 + 2 * v3 + v4);
        rate += kFine / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
      }
      ASSERT_NEAR(compliance.Step(p, load, kStep), eta, 1e-11)
          << "zeta " << damping << " step " << i;
      ASSERT_NEAR(compliance.rate(), rate, 1e-9);
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

TEST(Compliance, AStiffOverdampedOneOverALongStepComesToRest) {
  // Of cosh(w h) and e^(-alpha h), w h = 10,882, the first is above any number and the second 0.
  const double omega = 2 * M_PI * 1000, K = 5;
  JointErrorParameters p = NominalPandaErrors()[0];
  p.K = K, p.M_eff = K / (omega * omega), p.D = 4 * K / omega;
  Compliance compliance;
  compliance.Reset(0);
  EXPECT_NEAR(compliance.Step(p, 10, 1), -10 / K, 1e-12);
  EXPECT_NEAR(compliance.rate(), 0, 1e-9);
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
