// Friction in motion: seven uncoupled joints of one inertia, I dv/dt = tau + eta_fric, stepped as
// the simulator steps, against the static torque at which they break away and against a fine
// integration.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/common/joint_errors/free_joints.h"

namespace robostress {
namespace {

using Vector = Vector7;
constexpr double kStep = 0.002;  // [s]
constexpr double kInertia = 2;   // [kg m^2], between the armatures of the Panda's joints

JointChain Stribeck(int level, FrictionLaw law) {
  JointErrorOptions options;
  options.friction_law = law;
  JointChain stack(7, options);
  stack.SetScenario(MakeScenario("isolated_stribeck", level).value(), 1);
  ResetAt(stack, Vector::Zero(), Vector::Zero());
  return stack;
}

// One semi-implicit Euler step of the velocities [rad/s] under the driving torque [Nm].
void Advance(JointChain& stack, const Vector& drive, Vector& v) {
  const FreeJoints joints{.dq = v, .inertia = kInertia, .h = kStep};
  v += kStep / kInertia * TorqueOf(stack, drive, Vector::Zero(), joints);
}

TEST(Breakaway, AStuckJointMovesAtItsStaticTorque) {
  constexpr double kRamp = 0.5 * kStep;  // [Nm] per step
  for (const int level : {1, 3, 5}) {
    for (const double sign : {1.0, -1.0}) {
      JointChain stack = Stribeck(level, FrictionLaw::kStick);
      Vector v = Vector::Zero(), breakaway = Vector::Zero();
      for (double tau = kRamp; breakaway.minCoeff() == 0 && tau < 10; tau += kRamp) {
        Advance(stack, Vector::Constant(sign * tau), v);
        for (int j = 0; j < 7; ++j) {
          if (breakaway[j] == 0 && sign * v[j] > 1e-12) breakaway[j] = tau;
        }
      }
      for (int j = 0; j < 7; ++j) {
        const double Fs = stack.severity().parameters()[j].Fs;
        EXPECT_GE(breakaway[j], Fs) << "joint " << j + 1 << " level " << level;
        EXPECT_LE(breakaway[j], Fs + 1.001 * kRamp) << "joint " << j + 1 << " level " << level;
      }
    }
  }
}

TEST(Breakaway, TheLiteralLawStaysInItsChatterBandBelowTheStaticTorqueAndLeavesItAbove) {
  // From v <= 0 one step adds at most h (tau + Fs) / I: below Fs this is how fast a joint chatters.
  // In that band the law has lost at most 1.5 % of Fs - Fc, less than the 2 % on either side.
  JointChain stack = Stribeck(5, FrictionLaw::kSgn);
  for (const double share : {0.98, 1.02}) {
    Vector v = Vector::Zero(), drive, fastest = Vector::Zero();
    for (int j = 0; j < 7; ++j) drive[j] = share * stack.severity().parameters()[j].Fs;
    for (int i = 0; i < 2000; ++i) {
      Advance(stack, drive, v);
      fastest = fastest.cwiseMax(v.cwiseAbs());
    }
    for (int j = 0; j < 7; ++j) {
      const double band = kStep * (drive[j] + stack.severity().parameters()[j].Fs) / kInertia;
      if (share < 1) {
        EXPECT_LE(fastest[j], band) << "joint " << j + 1;
      } else {
        EXPECT_GT(fastest[j], 10 * band) << "joint " << j + 1;
      }
    }
  }
}

// dv/dt of a sliding joint, the paper's law written out.
double SlidingAcceleration(const JointErrorParameters& p, double v) {
  const double dry = p.Fc + (p.Fs - p.Fc) * std::exp(-std::pow(v / p.vs, 2));
  return -(std::copysign(dry, v) + p.sigma_v * v) / kInertia;
}

double RungeKutta4(const JointErrorParameters& p, double v, double h) {
  const double k1 = SlidingAcceleration(p, v), k2 = SlidingAcceleration(p, v + h / 2 * k1),
               k3 = SlidingAcceleration(p, v + h / 2 * k2), k4 = SlidingAcceleration(p, v + h * k3);
  return v + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
}

TEST(Breakaway, ACoastingJointFollowsTheIntegratedLawAndComesToRest) {
  for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kStick}) {
    JointChain stack = Stribeck(5, law);
    Vector v = Vector::Constant(-1), exact = v;
    for (int i = 0; i < 2500; ++i) {
      Advance(stack, Vector::Zero(), v);
      for (int j = 0; j < 7; ++j) {
        const JointErrorParameters& p = stack.severity().parameters()[j];
        const double band = kStep * p.Fs / kInertia;
        if (exact[j] < -5 * band) {
          for (int k = 0; k < 20; ++k) exact[j] = RungeKutta4(p, exact[j], kStep / 20);
          // First order in the step: at most a few per cent of what one step takes away.
          EXPECT_NEAR(v[j], exact[j], 0.5 * band) << "joint " << j + 1 << " step " << i;
        }
      }
    }
    for (int j = 0; j < 7; ++j) {
      const double band = kStep * stack.severity().parameters()[j].Fs / kInertia;
      EXPECT_LE(std::abs(v[j]), law == FrictionLaw::kStick ? 1e-12 : band) << "joint " << j + 1;
    }
  }
}

}  // namespace
}  // namespace robostress
