#include "common/joint_errors/effects/effect_library.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

namespace robostress {
namespace {

std::unique_ptr<JointEffect> Make(const std::string& type, const std::vector<double>& values) {
  const auto info = FindEffect(type);
  EXPECT_TRUE(info.ok()) << info.status();
  EXPECT_EQ((*info)->parameters.size(), values.size()) << type;
  auto effect = (*info)->make();
  effect->SetParameters(values);
  return effect;
}

// A moment with every field of its own.
JointMoment Moment() {
  JointMoment m;
  m.t = 12;
  m.h = 0.002;
  m.q = 0.7;
  m.dq = -0.4;
  m.drive = -5;
  m.gravity = 8;
  m.payload_gravity = 3;
  m.payload_inertia = 0.25;
  m.tilt_gravity[0] = 2;
  m.tilt_gravity[1] = -7;
  m.coupled_q = 0.3;
  m.coupled_dq = -0.9;
  m.coupled_ddq = 2;
  m.temperature = 45;
  return m;
}

struct Law {
  const char* type;
  std::vector<double> values;
  double torque, forward, backward;  // at Moment()
};

TEST(EffectLibrary, TorquesAndDryLimitsFollowTheirPrintedLaws) {
  const double wave = 2 * M_PI / 0.5 * 0.7, periodic = 0.2 * std::cos(wave) + 0.3 * std::sin(wave);
  const double stribeck = 1 + (1.5 - 1) * std::exp(-(0.4 / 0.1) * (0.4 / 0.1));
  const Law laws[] = {
      {"stribeck_friction", {1, 1.5, 0.1, 0.2}, 0.2 * 0.4, stribeck, stribeck},
      {"asymmetric_coulomb", {0.3}, 0, 0.3, -0.3},
      {"asymmetric_viscous", {0.5}, -0.5 * 0.4, 0, 0},
      {"load_dependent_friction", {0.1}, 0, 0.5, 0.5},
      {"gravity_dependent_friction", {0.1}, 0, 0.8, 0.8},
      {"quadratic_viscous_friction", {2}, 2 * 0.16, 0, 0},
      {"time_drift_friction", {0.01}, 0, 0.12, 0.12},
      {"temperature_friction", {-0.02, 0.01, 25, 99}, 0.01 * 20 * 0.4, -0.4, -0.4},
      {"position_dependent_friction", {0.2, 0.3, 0.5}, 0, periodic, periodic},
      {"gravity_error", {0.1}, 0.8, 0, 0},
      {"payload", {2}, -6, 0, 0},
      {"position_periodic_torque", {0.2, 0.3, 0.5}, periodic, 0, 0},
      {"position_dependent_torque", {1, 2, 3}, 0.7 + 2 * 0.49 + 3 * 0.343, 0, 0},
      {"cable_spring", {4, 0.2}, -4 * 0.5, 0, 0},
      {"cross_joint_coupling", {4}, -4 * 0.3, 0, 0},
      {"cross_joint_friction",
       {0.5, 0.2, 0.3, 0.1},
       0.5 * std::tanh(9.0) + 0.2 * 0.9,
       0.3 * 0.9,
       0.3 * 0.9},
      // The other joint turns at -0.9 rad/s, this one at -0.4: it is dragged, one way or the other.
      {"cross_joint_rubbing",
       {2, 1, 0.01},
       2 * std::tanh(50.0) * std::tanh(90.0),
       -2 * std::tanh(50.0),
       -2 * std::tanh(50.0)},
      {"cross_joint_rubbing", {2, -0.4, 0.01}, 0, 0, 0},
      {"cross_joint_inertia", {0.3}, -0.6, 0, 0},
      {"base_tilt", {0.1, 0.2}, -(0.1 * 2 - 0.2 * 7), 0, 0},
  };
  for (const Law& law : laws) {
    DryFriction dry;
    EXPECT_NEAR(Make(law.type, law.values)->Torque(Moment(), dry), law.torque, 1e-12) << law.type;
    EXPECT_NEAR(dry.forward, law.forward, 1e-12) << law.type;
    EXPECT_NEAR(dry.backward, law.backward, 1e-12) << law.type;
  }
  EXPECT_NEAR(Make("payload", {2})->Inertia(Moment()), 0.5, 1e-12);
}

TEST(EffectLibrary, ATemperatureThatNobodyMeasuresIsTheEffectsOwn) {
  JointMoment m = Moment();
  m.temperature = JointMoment().temperature;
  DryFriction dry;
  Make("temperature_friction", {-0.02, 0, 25, 35})->Torque(m, dry);
  EXPECT_NEAR(dry.forward, -0.2, 1e-12);
}

TEST(EffectLibrary, DrivesSaturateOnBothSidesLoseTheirDeadZoneAndDriftInTime) {
  const JointMoment m = Moment();
  for (const double sign : {1.0, -1.0}) {
    EXPECT_EQ(Make("torque_saturation", {3})->Drive(sign * 5, m), sign * 3);
    EXPECT_EQ(Make("torque_saturation", {3})->Drive(sign * 2, m), sign * 2);
    EXPECT_EQ(Make("deadzone", {0.5})->Drive(sign * 2, m), sign * 1.5);
    EXPECT_EQ(Make("deadzone", {0.5})->Drive(sign * 0.4, m), 0);
    EXPECT_NEAR(Make("time_varying_gain", {0.01})->Drive(sign * 5, m), sign * 5.6, 1e-12);
    EXPECT_NEAR(Make("motor_gain", {-0.12})->Drive(sign * 5, m), sign * 4.4, 1e-12);
  }
}

TEST(EffectLibrary, ReadingsAreScaledAndShifted) {
  EXPECT_NEAR(Make("encoder_gain", {0.02})->Reading(0.5), 0.51, 1e-12);
  EXPECT_NEAR(Make("encoder_offset", {0.02})->Reading(0.5), 0.52, 1e-12);
  EXPECT_NEAR(Make("encoder_eccentricity", {0.01, 0.02, 2 * M_PI})->Reading(0.5),
              0.5 + 0.01 * std::cos(0.5) + 0.02 * std::sin(0.5), 1e-12);
}

TEST(EffectLibrary, SlopesOfReadingsAreTheirDerivatives) {
  constexpr double kStep = 1e-6;
  const std::pair<const char*, std::vector<double>> sensors[] = {
      {"encoder_gain", {0.02}},
      {"encoder_offset", {0.02}},
      {"encoder_eccentricity", {0.01, 0.02, 2.5}}};
  for (const auto& [type, values] : sensors) {
    const auto effect = Make(type, values);
    for (const double q : {-2.0, 0.1, 1.3})
      EXPECT_NEAR(effect->ReadingSlope(q),
                  (effect->Reading(q + kStep) - effect->Reading(q - kStep)) / (2 * kStep), 1e-9)
          << type;
  }
}

TEST(EffectLibrary, ACommandIsDelayedLinearlyBetweenSamples) {
  // A ramp of 1 per second through a delay of 2.5 sub-steps.
  auto delay = Make("transport_delay", {0.005});
  JointMoment m = Moment();
  delay->Reset(m);
  for (int i = 0; i < 20; ++i) {
    const double t = i * m.h, delayed = delay->Command(t, m);
    EXPECT_NEAR(delayed, std::max(0.0, t - 0.005), i < 3 ? 0.0021 : 1e-12) << i;
  }
}

TEST(EffectLibrary, ALagIsTheExponentialWhateverTheStep) {
  for (const double h : {0.001, 0.002, 0.01}) {
    auto lag = Make("servo_lag", {0.05});
    JointMoment m = Moment();
    m.h = h;
    lag->Reset(m);
    EXPECT_EQ(lag->Command(2, m), 2) << "a joint at rest where it was told to be";
    double value = 0;
    for (int i = 0; i < std::lround(0.1 / h); ++i) value = lag->Command(3, m);
    EXPECT_NEAR(value, 3 - std::exp(-0.1 / 0.05), 1e-9);
  }
}

TEST(EffectLibrary, ARateIsLimitedPerSecond) {
  for (const double sign : {1.0, -1.0}) {
    auto limit = Make("rate_limit", {0.5});
    JointMoment m = Moment();
    limit->Reset(m);
    limit->Command(0, m);
    double value = 0;
    for (int i = 0; i < 100; ++i) value = limit->Command(sign, m);
    EXPECT_NEAR(value, sign * 0.5 * 100 * m.h, 1e-12);
  }
}

TEST(EffectLibrary, PreslidingDependsOnTheWayNotOnTheStep) {
  // From rest: z = 1 - exp(-x / x_s); back again from there: z = -1 + (1 + z_0) exp(-x / x_s).
  for (const double h : {0.001, 0.004}) {
    auto dahl = Make("presliding_hysteresis", {3, 0.02});
    JointMoment m = Moment();
    m.h = h;
    dahl->Reset(m);
    DryFriction dry;
    double torque = 0;
    m.dq = 0.5;
    for (int i = 0; i < std::lround(0.04 / h); ++i) torque = dahl->Torque(m, dry);
    const double there = 1 - std::exp(-1.0);
    EXPECT_NEAR(torque, -3 * there, 1e-12);
    m.dq = -0.5;
    for (int i = 0; i < std::lround(0.02 / h); ++i) torque = dahl->Torque(m, dry);
    EXPECT_NEAR(torque, -3 * (-1 + (1 + there) * std::exp(-0.5)), 1e-12);
  }
}

TEST(EffectLibrary, TransmissionsDeflect) {
  JointMoment m = Moment();
  const double wave = 2 * M_PI / 0.5 * m.q;
  EXPECT_NEAR(Make("transmission_error", {0.01, 0.02, 0.5})->Offset(m),
              0.01 * std::cos(wave) + 0.02 * std::sin(wave), 1e-15);
  auto gap = Make("backlash", {0.1});
  gap->Reset(m);
  EXPECT_EQ(gap->Offset(m), 0) << "mid-gap";
  m.q += 0.3;
  EXPECT_NEAR(gap->Offset(m), -0.1, 1e-12);
}

TEST(EffectLibrary, ComplianceRingsWithTheStatedFrequencyAndDamping) {
  // After a step of the load the deflection overshoots by exp(-pi zeta / sqrt(1 - zeta^2)), half a
  // period after the step.
  const double K = 500, f = 4, zeta = 0.2, damped = f * std::sqrt(1 - zeta * zeta);
  auto spring = Make("compliance", {K, f, zeta});
  JointMoment m = Moment();
  m.h = 1e-4;
  m.drive = 0;
  spring->Reset(m);
  m.drive = 5;
  double lowest = 0, at = 0;
  for (int i = 1; i <= 2500; ++i) {
    const double offset = spring->Offset(m);
    if (offset < lowest) lowest = offset, at = i * m.h;
  }
  EXPECT_NEAR(lowest, -5 / K * (1 + std::exp(-M_PI * zeta / std::sqrt(1 - zeta * zeta))), 1e-7);
  EXPECT_NEAR(at, 0.5 / damped, 2e-4);
}

}  // namespace
}  // namespace robostress
