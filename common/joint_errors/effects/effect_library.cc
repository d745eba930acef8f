#include "common/joint_errors/effects/effect_library.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/joint_errors/effects/effect_makers.h"

namespace robostress {
namespace {

using enum EffectScale;
using enum EffectStage;

// Shapes that several effects share.
EffectParameter Signed(const char* name, const char* unit, EffectScale scale, double bound,
                       double start) {
  return {name, unit, scale, -bound, bound, {start, -start}};
}
EffectParameter Positive(const char* name, const char* unit, EffectScale scale, double bound,
                         std::vector<double> starts) {
  return {name, unit, scale, 0, bound, std::move(starts)};
}
// A limit: absent at infinity.
EffectParameter Limit(const char* name, const char* unit, EffectScale scale,
                      std::vector<double> starts) {
  EffectParameter parameter = {name, unit, scale, 0, 100, std::move(starts)};
  parameter.inverse = true;
  return parameter;
}
EffectParameter Wavelength(const char* unit) {
  EffectParameter parameter = {"wavelength", unit, kPosition, 0.02, 2.2, {}};
  // A grid of spatial frequencies: half a period more over the range travelled, 2 P,
  // each, from a whole one on.
  for (int k = 2; k <= 80; ++k) parameter.starts.push_back(4.0 / k);
  return parameter;
}
EffectParameter Fixed(const char* name, const char* unit, double lower, double upper,
                      double value) {
  EffectParameter parameter = {name, unit, kOne, lower, upper, {value}};
  parameter.fixed = true;
  return parameter;
}
EffectParameter Late(const char* name, const char* unit, double lower, double upper, double value) {
  EffectParameter parameter = Fixed(name, unit, lower, upper, value);
  parameter.late = true;
  return parameter;
}

std::vector<EffectInfo> MakeLibrary() {
  return {
      {"stribeck_friction",
       kJoint,
       {Positive("Fc", "Nm", kTorque, 2, {0.05}), Positive("Fs", "Nm", kTorque, 3, {0.1}),
        Positive("vs", "rad/s", kVelocity, 5, {0.1, 0.3}),
        Positive("sigma_v", "Nm s/rad", kTorquePerVelocity, 5, {0.02})},
       {0, 1, 3},
       "dry limit Fc + (Fs - Fc) exp(-(dq/vs)^2), torque -sigma_v dq",
       "slow motion and reversals",
       {"deadzone", "presliding_hysteresis", "load_dependent_friction"},
       "slow ramps through rest at several speeds",
       effects::StribeckFriction},
      {"asymmetric_coulomb",
       kJoint,
       {Signed("dFc", "Nm", kTorque, 1, 0.03)},
       {0},
       "dry limit +dFc forwards, -dFc backwards",
       "motion both ways",
       {"encoder_offset", "gravity_error", "asymmetric_viscous"},
       "breakaway torques from rest, both ways",
       effects::AsymmetricCoulomb},
      {"asymmetric_viscous",
       kJoint,
       {Signed("d_sigma", "Nm s/rad", kTorquePerVelocity, 1, 0.03)},
       {0},
       "torque -d_sigma |dq|",
       "three speeds each way",
       {"asymmetric_coulomb"},
       "several speeds each way",
       effects::AsymmetricViscous},
      {"load_dependent_friction",
       kJoint,
       {Positive("mu", "1", kOne, 0.9, {0.05})},
       {0},
       "dry limit + mu |drive torque|",
       "equal speeds at different loads",
       {"stribeck_friction", "gravity_dependent_friction", "torque_saturation", "time_varying_gain",
        "deadzone"},
       "the same motion with another payload; torque-off falls",
       effects::LoadDependentFriction},
      {"gravity_dependent_friction",
       kJoint,
       {Positive("mu", "1", kOne, 0.9, {0.05})},
       {0},
       "dry limit + mu |g(q)|",
       "equal speeds at different postures",
       {"load_dependent_friction", "position_dependent_friction", "stribeck_friction"},
       "one posture passed at small and large accelerations",
       effects::GravityDependentFriction},
      {"quadratic_viscous_friction",
       kJoint,
       {Positive("c2", "Nm s^2/rad^2", kTorquePerVelocity2, 5, {0.02})},
       {0},
       "torque -c2 dq |dq|",
       "a wide range of speeds",
       {"asymmetric_viscous", "stribeck_friction"},
       "constant speeds over a decade",
       effects::QuadraticViscousFriction},
      {"time_drift_friction",
       kJoint,
       {Signed("rate", "Nm/s", kTorquePerSecond, 1, 0.003)},
       {0},
       "dry limit + rate t",
       "a motion that repeats over the log",
       {"temperature_friction", "time_varying_gain", "asymmetric_viscous"},
       "runs in random order, the first one repeated",
       effects::TimeDriftFriction},
      {"temperature_friction",
       kJoint,
       {Signed("c", "Nm/K", kTorquePerKelvin, 2, 0.03),
        Signed("v", "Nm s/rad/K", kTorquePerVelocityKelvin, 2, 0.03),
        {"T_ref", "deg C", kColdest, -50, 150, {20}, false, true},
        Fixed("T", "deg C", -50, 150, 40)},
       {0, 1},
       "dry limit + c (temp - T_ref), torque -v (temp - T_ref) dq; temp is T where it is not "
       "measured",
       "a logged temperature that changes",
       {"time_drift_friction", "time_varying_gain"},
       "the same motion cold and warm, and warm again after a rest",
       effects::TemperatureFriction,
       false,
       true},
      {"presliding_hysteresis",
       kJoint,
       {Positive("F", "Nm", kTorque, 2, {0.05}),
        Positive("x_s", "rad", kPosition, 1, {0.01, 0.05})},
       {0},
       "Dahl: torque -F z, dz/dx = (1 - sgn(dx) z) / x_s",
       "reversals of small amplitude",
       {"stribeck_friction", "backlash", "compliance", "cable_spring"},
       "a ladder of small amplitudes",
       effects::PreslidingHysteresis},
      {"position_dependent_friction",
       kJoint,
       {Signed("a", "Nm", kTorque, 1, 0.03), Signed("b", "Nm", kTorque, 1, 0.03),
        Wavelength("rad")},
       {0, 1},
       "dry limit + a cos(2 pi q / wavelength) + b sin(2 pi q / wavelength)",
       "the range travelled both ways",
       {"position_periodic_torque", "presliding_hysteresis"},
       "slow travel of the range, both ways",
       effects::PositionDependentFriction},
      {"gravity_error",
       kJoint,
       {Signed("beta", "1", kOne, 1, 0.05)},
       {0},
       "torque + beta g(q)",
       "a wide range of gravity torque",
       {"payload", "encoder_offset", "base_tilt", "position_dependent_torque"},
       "a known added mass, or acceleration that gravity does not change",
       effects::GravityError},
      {"payload",
       kJoint,
       {Positive("mass", "kg", kPayload, 2, {0.05})},
       {0},
       "1 kg units of gravity torque and inertia at the tip",
       "gravity and acceleration",
       {"gravity_error", "time_varying_gain"},
       "a known added mass; fast motion across the vertical",
       effects::Payload},
      {"position_periodic_torque",
       kJoint,
       {Signed("a", "Nm", kTorque, 1, 0.03), Signed("b", "Nm", kTorque, 1, 0.03),
        Wavelength("rad")},
       {0, 1},
       "torque a cos(2 pi q / wavelength) + b sin(2 pi q / wavelength)",
       "slow travel over several wavelengths",
       {"transmission_error", "position_dependent_friction", "position_dependent_torque"},
       "the same travel at two speeds",
       effects::PositionPeriodicTorque},
      {"position_dependent_torque",
       kJoint,
       {Signed("c1", "Nm/rad", kTorquePerPosition, 2, 0.03),
        Signed("c2", "Nm/rad^2", kTorquePerPosition2, 2, 0.03),
        Signed("c3", "Nm/rad^3", kTorquePerPosition3, 2, 0.03)},
       {0, 1, 2},
       "torque c1 q + c2 q^2 + c3 q^3",
       "a wide range of positions",
       {"cable_spring", "gravity_error", "position_periodic_torque", "payload"},
       "slow travel of the whole range",
       effects::PositionDependentTorque},
      {"cable_spring",
       kJoint,
       {Signed("k", "Nm/rad", kTorquePerPosition, 2, 0.03),
        {"q0", "rad", kPosition, -4, 4, {0, 1, -1}}},
       {0},
       "torque -k (q - q0)",
       "a wide range of positions",
       {"position_dependent_torque", "gravity_error", "presliding_hysteresis"},
       "slow travel of the whole range",
       effects::CableSpring},
      {"transmission_error",
       kTransmission,
       {Signed("a", "rad", kPosition, 0.2, 0.003), Signed("b", "rad", kPosition, 0.2, 0.003),
        Wavelength("rad")},
       {0, 1},
       "link = motor + a cos(2 pi q / wavelength) + b sin(2 pi q / wavelength)",
       "travel over several wavelengths",
       {"position_periodic_torque", "encoder_gain"},
       "both encoders, or the same travel at two servo gains",
       effects::TransmissionError},
      {"backlash",
       kTransmission,
       {Positive("B", "rad", kPosition, 0.5, {0.003, 0.01, 0.03})},
       {0},
       "Tao-Kokotovic deadband of half-width B between motor and link",
       "reversals",
       {"presliding_hysteresis", "compliance", "transport_delay"},
       "reversals at two speeds and one load",
       effects::BacklashGap},
      {"compliance",
       kTransmission,
       {Limit("K", "Nm/rad", kTorquePerPosition, {0.003, 0.03}),
        Late("frequency", "Hz", 1, 1000, 15), Late("zeta", "1", 0.05, 2, 0.7)},
       {0},
       "M_eff eta'' + D eta' + K eta = -drive torque",
       "load that changes",
       {"transport_delay", "backlash", "presliding_hysteresis", "servo_lag"},
       "one speed at several loads",
       effects::TransmissionCompliance},
      {"encoder_gain",
       kSensor,
       {Signed("gain_error", "1", kOne, 0.5, 0.01)},
       {0},
       "reading = (1 + gain_error) q",
       "an absolute reference, or gravity over a wide range",
       {"transmission_error", "gravity_error"},
       "a second encoder",
       effects::EncoderGain},
      {"encoder_eccentricity",
       kSensor,
       {Signed("a", "rad", kPosition, 0.2, 0.003), Signed("b", "rad", kPosition, 0.2, 0.003),
        Fixed("wavelength", "rad", 0.01, 100, 2 * M_PI)},
       {0, 1},
       "reading = q + a cos(2 pi q / wavelength) + b sin(2 pi q / wavelength)",
       "an absolute reference over most of a turn",
       {"encoder_gain", "encoder_offset", "transmission_error", "gravity_error"},
       "a second encoder over a whole turn",
       effects::EncoderEccentricity},
      {"encoder_offset",
       kSensor,
       {Signed("offset", "rad", kPosition, 2, 0.02)},
       {0},
       "reading = q + offset",
       "an absolute reference, or gravity over a wide range",
       {"gravity_error", "asymmetric_coulomb", "base_tilt"},
       "two payloads over a wide range",
       effects::EncoderOffset},
      {"transport_delay",
       kCommand,
       {Positive("delay_s", "s", kSample, 40, {0.5, 1, 2, 4, 8, 16})},
       {0},
       "what arrives is command(t - delay_s)",
       "motion that changes within the delay",
       {"servo_lag", "compliance"},
       "a chirp beyond 1 / (2 pi delay)",
       effects::TransportDelay},
      {"servo_lag",
       kCommand,
       {Positive("tau_s", "s", kSample, 100, {0.5, 2, 8})},
       {0},
       "first-order lag of the command, time constant tau_s",
       "motion that changes within the lag",
       {"transport_delay", "compliance"},
       "a chirp beyond 1 / (2 pi tau)",
       effects::ServoLag},
      {"rate_limit",
       kCommand,
       {Limit("rate", "rad/s", kVelocity, {0.2, 0.5, 1})},
       {0},
       "|d command / dt| <= rate",
       "fast commands",
       {"servo_lag", "torque_saturation"},
       "steps of several sizes",
       effects::RateLimit,
       false,
       false,
       true},
      {"torque_saturation",
       kDrive,
       {Limit("limit", "Nm", kTorque, {0.3, 0.6, 1})},
       {0},
       "|drive| <= limit",
       "large commands",
       {"rate_limit", "load_dependent_friction"},
       "a load that needs more than the limit",
       effects::TorqueSaturation},
      {"deadzone",
       kDrive,
       {Positive("width", "Nm", kTorque, 1, {0.03, 0.1})},
       {0},
       "drive loses `width`, and is zero below it",
       "small torques",
       {"stribeck_friction", "load_dependent_friction"},
       "slow torque ramps through zero",
       effects::Deadzone},
      {"cross_joint_coupling",
       kJoint,
       {Signed("k", "Nm/rad", kTorquePerPosition, 2, 0.03)},
       {0},
       "torque -k times the position of another joint",
       "the other joint moving while this one rests",
       {"position_dependent_torque", "gravity_error", "cross_joint_inertia"},
       "one joint moved at a time",
       effects::CrossJointCoupling,
       true},
      {"cross_joint_friction",
       kJoint,
       {Signed("F", "Nm", kTorque, 2, 0.03), Signed("d", "Nm s/rad", kTorquePerVelocity, 2, 0.03),
        Signed("c", "Nm s/rad", kTorquePerVelocity, 2, 0.03), Fixed("v0", "rad/s", 1e-4, 1, 0.02)},
       {0, 1, 2},
       "torque -F tanh(dq' / v0) - d dq', dry limit + c |dq'|; dq': another joint's velocity",
       "the other joint moving at several speeds while this one rests and while it moves",
       {"cross_joint_rubbing", "cross_joint_coupling", "cross_joint_inertia"},
       "one joint moved at a time, then both",
       effects::CrossJointFriction,
       true},
      {"cross_joint_rubbing",
       kJoint,
       {Positive("F", "Nm", kTorque, 2, {0.03}), Signed("n", "1", kOne, 3, 1),
        Fixed("v0", "rad/s", 1e-4, 1, 0.02)},
       {0},
       "dry friction -F sgn(dq + n dq') in place of -F sgn(dq); dq': another joint's velocity",
       "both joints moving, each the faster for a while",
       {"cross_joint_friction", "asymmetric_coulomb"},
       "one joint moved at a time, then both with and against each other",
       effects::CrossJointRubbing,
       true},
      {"cross_joint_inertia",
       kJoint,
       {Signed("J", "kg m^2", kTorquePerAcceleration, 2, 0.03)},
       {0},
       "torque -J times the acceleration of another joint",
       "the other joint accelerating while this one rests",
       {"cross_joint_coupling", "cross_joint_friction", "payload"},
       "one joint moved at a time, slowly and fast",
       effects::CrossJointInertia,
       true},
      {"base_tilt",
       kJoint,
       {Signed("x", "rad", kOne, 0.5, 0.02), Signed("y", "rad", kOne, 0.5, 0.02)},
       {0, 1},
       "gravity turned about the base's x and y",
       "two joints, or a wide range of one",
       {"gravity_error", "encoder_offset"},
       "a level",
       effects::BaseTilt},
      {"time_varying_gain",
       kDrive,
       {Signed("rate", "1/s", kOne, 0.1, 0.002)},
       {0},
       "drive (1 + rate t)",
       "a motion that repeats over the log",
       {"time_drift_friction", "payload"},
       "runs in random order, the first one repeated",
       effects::TimeVaryingGain},
      {"motor_gain",
       kDrive,
       {Signed("gain_error", "1", kOne, 0.6, 0.03)},
       {0},
       "drive (1 + gain_error): a motor constant that is not the declared one",
       "gravity or a known inertia beside friction",
       {"payload", "gravity_error", "time_varying_gain", "torque_saturation"},
       "a known added mass at rest",
       effects::MotorGain},
  };
}

}  // namespace

const std::vector<EffectInfo>& EffectLibrary() {
  static const auto& library = *new std::vector<EffectInfo>(MakeLibrary());
  return library;
}

absl::StatusOr<const EffectInfo*> FindEffect(const std::string& type) {
  std::vector<std::string> known;
  for (const EffectInfo& effect : EffectLibrary()) {
    if (effect.type == type) return &effect;
    known.push_back(effect.type);
  }
  return absl::NotFoundError(
      absl::StrCat("effect '", type, "' is unknown; known: ", absl::StrJoin(known, ", ")));
}

absl::StatusOr<int> FindParameter(const EffectInfo& effect, const std::string& name) {
  std::vector<std::string> known;
  for (size_t i = 0; i < effect.parameters.size(); ++i) {
    if (effect.parameters[i].name == name) return static_cast<int>(i);
    known.push_back(effect.parameters[i].name);
  }
  return absl::NotFoundError(absl::StrCat("effect '", effect.type, "' has no parameter '", name,
                                          "'; known: ", absl::StrJoin(known, ", ")));
}

const char* StageName(EffectStage stage) {
  switch (stage) {
    case kCommand:
      return "command";
    case kDrive:
      return "drive";
    case kJoint:
      return "torque";
    case kTransmission:
      return "transmission";
    case kSensor:
      return "sensor";
  }
  return "";
}

}  // namespace robostress
