#include "common/joint_errors/effects/friction.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "common/joint_errors/effects/gravity_residual.h"
#include "common/joint_errors/stick_friction.h"

namespace robostress {
namespace {

const JointErrorParameters kJoint = {.Fc = 2, .Fs = 3, .vs = 0.1, .sigma_v = 0.5};

TEST(Friction, FollowsTheStribeckCurve) {
  // -[2 + 1 e^-1] - 0.5 * 0.1 at the Stribeck velocity.
  EXPECT_DOUBLE_EQ(StribeckTorque(kJoint, 0.1, FrictionLaw::kSgn, 0.01),
                   -(2 + std::exp(-1.0)) - 0.05);
  EXPECT_NEAR(StribeckTorque(kJoint, 1e-9, FrictionLaw::kSgn, 0.01), -3, 1e-6);  // static at creep
  EXPECT_NEAR(StribeckTorque(kJoint, 1.0, FrictionLaw::kSgn, 0.01), -2.5,
              1e-6);  // kinetic and viscous when fast
}

TEST(Friction, FollowsThePapersLawOverAVelocityGridAtEverySeverity) {
  // Fc, Fs, vs, sigma_v of tab:base_params; the law in its exponential-free form, ln of what is
  // left when viscous and kinetic parts are taken off: ln((|eta| - sigma_v v - Fc) / (Fs - Fc)) =
  // -(v/vs)^2.
  for (int j = 0; j < 7; ++j) {
    const double Fc = j < 4 ? 2.175 : 0.480, Fs = j < 4 ? 3.480 : 0.720, vs = j < 4 ? 0.15 : 0.10,
                 sigma_v = j < 4 ? 0.348 : 0.048;
    for (const double w : {1.0, 1.5, 1.625, 1.75, 1.875, 2.0}) {
      const JointErrorParameters p = Scale(NominalPandaErrors()[j], {.friction = w});
      for (int k = -200; k <= 200; ++k) {
        const double v = 0.01 * k;
        const double eta = StribeckTorque(p, v, FrictionLaw::kSgn, 0.01);
        EXPECT_EQ((eta > 0) - (eta < 0), (v < 0) - (v > 0));  // power eta v <= 0: it dissipates
        if (k == 0) continue;
        const double decaying = std::abs(eta) - w * (sigma_v * std::abs(v) + Fc);
        if (std::abs(v) < 3 * vs) {
          EXPECT_NEAR(std::log(decaying / (w * (Fs - Fc))), -v * v / (vs * vs), 1e-10) << v;
        } else {
          EXPECT_NEAR(decaying, 0, w * (Fs - Fc) * std::exp(-9) + 1e-12) << v;
        }
      }
    }
  }
}

TEST(Friction, OpposesMotionAndIsOdd) {
  for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kTanh}) {
    for (const double dq : {1e-6, 0.003, 0.05, 0.7}) {
      EXPECT_LT(StribeckTorque(kJoint, dq, law, 0.01), 0);
      EXPECT_DOUBLE_EQ(StribeckTorque(kJoint, dq, law, 0.01),
                       -StribeckTorque(kJoint, -dq, law, 0.01));
    }
    EXPECT_EQ(StribeckTorque(kJoint, 0, law, 0.01), 0);
  }
}

TEST(Friction, TanhAgreesWithSgnAwayFromRestAndIsSmoothAtIt) {
  EXPECT_NEAR(StribeckTorque(kJoint, 0.2, FrictionLaw::kTanh, 0.01),
              StribeckTorque(kJoint, 0.2, FrictionLaw::kSgn, 0.01), 1e-12);
  // Slope at rest: -Fs / width - sigma_v.
  EXPECT_NEAR(StribeckTorque(kJoint, 1e-7, FrictionLaw::kTanh, 0.01) / 1e-7, -3 / 0.01 - 0.5, 1e-3);
}

TEST(Friction, StickHoldsAJointBelowTheStaticTorqueAndLetsItGoAbove) {
  const double inertia = 2, h = 0.002;
  const std::array<double, 1> A = {h / inertia}, limit = {3};
  std::array<double, 1> f;
  StickTorques(std::array{h / inertia * 2.9}, A, limit, limit,
               absl::MakeSpan(f));  // pushed from rest with 2.9 Nm
  EXPECT_NEAR(f[0], -2.9, 1e-12);
  StickTorques(std::array{h / inertia * 3.5}, A, limit, limit, absl::MakeSpan(f));
  EXPECT_DOUBLE_EQ(f[0], -3);
}

TEST(Friction, StickTorquesOfCoupledJointsSatisfyComplementarity) {
  // Inverse inertia of a coupled pair; joint 1 slides, joint 2 is held although joint 1 drags on
  // it.
  const std::array<double, 4> A = {1e-3, -4e-4, -4e-4, 2e-3};
  const std::array<double, 2> v_free = {0.02, -0.002}, limit = {3, 5};
  std::array<double, 2> f;
  StickTorques(v_free, A, limit, limit, absl::MakeSpan(f));
  for (int i = 0; i < 2; ++i) {
    const double v = v_free[i] + A[2 * i] * f[0] + A[2 * i + 1] * f[1];
    if (std::abs(f[i]) < limit[i] - 1e-9) {
      EXPECT_NEAR(v, 0, 1e-10);
    } else {
      EXPECT_DOUBLE_EQ(f[i], v > 0 ? -limit[i] : limit[i]);
    }
  }
  EXPECT_DOUBLE_EQ(f[0], -3);
  EXPECT_LT(std::abs(f[1]), 5);
}

TEST(Friction, ASlidingJointMeetsTheLimitOfItsDirection) {
  const std::array<double, 1> A = {1e-3}, forward = {3}, backward = {2};
  std::array<double, 1> f;
  StickTorques(std::array{0.1}, A, forward, backward, absl::MakeSpan(f));
  EXPECT_DOUBLE_EQ(f[0], -3);
  StickTorques(std::array{-0.1}, A, forward, backward, absl::MakeSpan(f));
  EXPECT_DOUBLE_EQ(f[0], 2);
}

TEST(Friction, StuckJointsThatDragOnEachOtherStandStill) {
  // The exact holding torques of two strongly coupled joints: A f = -v.
  const std::array<double, 4> A = {1e-3, -7e-4, -7e-4, 1e-3};
  const std::array<double, 2> v_free = {1e-3, 1e-3}, limit = {50, 50};
  std::array<double, 2> f;
  StickTorques(v_free, A, limit, limit, absl::MakeSpan(f));
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(f[i], -10.0 / 3, 1e-6);
}

TEST(GravityResidual, LiteralSignAddsToTheHoldingTorqueAndPayloadTakesFromIt) {
  const JointErrorParameters joint = {.beta = 0.1};
  EXPECT_DOUBLE_EQ(GravityResidual(joint, 20, GravitySign::kLiteral), 2);
  EXPECT_DOUBLE_EQ(GravityResidual(joint, 20, GravitySign::kPayload), -2);
}

}  // namespace
}  // namespace robostress
