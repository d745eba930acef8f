#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

using generator::Family;

// Data of a machine with one effect that its rig does not declare; the fit of the declared model
// with that effect must find the parameters that the machine has.
struct Recovery {
  const char* effect;
  Family family;
  uint64_t seed;
  // Parameter and how far off it may be, as a share of its size (of a and b: of their hypotenuse).
  std::vector<std::pair<const char*, double>> within;
};

void PrintTo(const Recovery& recovery, std::ostream* out) { *out << recovery.effect; }

// What the machine is, as the library counts it.
double TrueValue(const generator::GeneratedRig& rig, const std::string& name) {
  const generator::HiddenEffect& effect = rig.truth.effects.front();
  // A command that the servo sees continuously is half a row younger than one that holds.
  if ((name == "delay_s" || name == "tau_s") && !rig.commands_hold)
    return effect[name] - 0.5 / rig.rate_hz;
  return effect[name];
}

class EffectRecovery : public testing::TestWithParam<Recovery> {};

TEST_P(EffectRecovery, FitFindsTheTrueParametersInDataOfAnIndependentIntegrator) {
  const Recovery& recovery = GetParam();
  generator::RigOptions options;
  options.effects = {recovery.effect};
  options.family = recovery.family;
  options.seed = recovery.seed;
  options.richness = generator::Richness::kBrief;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder =
      testing::TempDir() + "/recovery_" + recovery.effect + "_" + std::to_string(recovery.seed);
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();

  const generator::HiddenEffect& truth = machine->truth.effects.front();
  const int joint = truth.joint;
  JointProblem problem = rig->Problem(joint);
  const WindowSet fit = problem.OfRole(LogRole::kFit), held_out = problem.OfRole(LogRole::kHeldOut);
  const auto declared = rig->Declared(joint);
  ASSERT_TRUE(declared.ok()) << declared.status();
  problem.LinearizeStarts(declared->model);
  const JointFit base = Minimise(problem, *declared, fit);
  problem.LinearizeStarts(ModelAt(base.best, base.best.x));
  const auto info = FindEffect(recovery.effect);
  ASSERT_TRUE(info.ok());
  std::vector<Hypothesis> starts = WithEffect(base.best, **info, rig->Scales(joint),
                                              rig->rig.joints.size() == 2 ? 1 - joint : -1);
  // A trace scans wavelengths by their signatures; here only those beside the true one.
  const std::string wave = std::string(recovery.effect) + ".wavelength";
  std::erase_if(starts, [&](const Hypothesis& start) {
    for (size_t i = 0; i < start.free.size(); ++i) {
      const double value = start.free[i].ToValue(start.x[static_cast<int>(i)]);
      if (start.free[i].path == wave && std::abs(value / truth["wavelength"] - 1) > 0.07)
        return true;
    }
    return false;
  });
  ASSERT_FALSE(starts.empty());
  const JointFit found =
      Minimise(problem, Settle(problem, Try(problem, starts, fit), fit).best, fit);

  JointModel model = ModelAt(found.best, found.best.x);
  for (const auto& [name, share] : recovery.within) {
    const auto value = FindValue(model, std::string(recovery.effect) + "." + name);
    ASSERT_TRUE(value.ok()) << value.status();
    const double expected = TrueValue(*machine, name);
    const bool wave_part = std::string(name) == "a" || std::string(name) == "b";
    const double size = wave_part ? std::hypot(truth["a"], truth["b"]) : std::abs(expected);
    EXPECT_NEAR(**value, expected, share * size) << name;
  }
  const auto rms = [&](const Hypothesis& h) {
    return problem.Projected(ModelAt(h, h.x), held_out).norm();
  };
  // The coupling of an arm and the torque of input inverse come from measured accelerations, whose
  // noise and smoothing stay.
  const bool smoothed = recovery.family == Family::kArm || recovery.family == Family::kInverse;
  const double least = smoothed ? 0.8 : 0.5;
  EXPECT_LT(rms(found.best), least * rms(base.best)) << "held-out error after and before";
  std::filesystem::remove_all(folder);
}

INSTANTIATE_TEST_SUITE_P(
    Library, EffectRecovery,
    testing::Values(
        Recovery{"stribeck_friction", Family::kServo, 1, {{"Fc", 0.05}, {"Fs", 0.1}, {"vs", 0.3}}},
        Recovery{"asymmetric_coulomb", Family::kServo, 1, {{"dFc", 0.05}}},
        Recovery{"asymmetric_viscous", Family::kServo, 1, {{"d_sigma", 0.05}}},
        Recovery{"load_dependent_friction", Family::kServo, 1, {{"mu", 0.1}}},
        Recovery{"gravity_dependent_friction", Family::kServo, 1, {{"mu", 0.1}}},
        Recovery{"quadratic_viscous_friction", Family::kServo, 1, {{"c2", 0.05}}},
        Recovery{"time_drift_friction", Family::kServo, 1, {{"rate", 0.05}}},
        Recovery{"temperature_friction", Family::kServo, 1, {{"v", 0.1}}},
        Recovery{"temperature_friction", Family::kServo, 2, {{"c", 0.1}}},
        Recovery{"presliding_hysteresis", Family::kServo, 1, {{"F", 0.05}, {"x_s", 0.1}}},
        Recovery{"position_dependent_friction",
                 Family::kServo,
                 1,
                 {{"a", 0.1}, {"b", 0.1}, {"wavelength", 0.02}}},
        Recovery{"gravity_error", Family::kServo, 1, {{"beta", 0.05}}},
        Recovery{"payload", Family::kServo, 1, {{"mass", 0.05}}},
        Recovery{"position_periodic_torque",
                 Family::kServo,
                 1,
                 {{"a", 0.1}, {"b", 0.1}, {"wavelength", 0.02}}},
        Recovery{"position_dependent_torque",
                 Family::kServo,
                 1,
                 {{"c1", 0.1}, {"c2", 0.1}, {"c3", 0.1}}},
        Recovery{"cable_spring", Family::kSlide, 1, {{"k", 0.05}, {"q0", 0.1}}},
        Recovery{"transmission_error",
                 Family::kServo,
                 1,
                 {{"a", 0.1}, {"b", 0.1}, {"wavelength", 0.02}}},
        Recovery{"backlash", Family::kServo, 1, {{"B", 0.1}}},
        Recovery{"backlash", Family::kTransmission, 2, {{"B", 0.05}}},
        Recovery{"compliance", Family::kServo, 1, {{"K", 0.15}}},
        Recovery{"compliance", Family::kTransmission, 2, {{"K", 0.15}}},
        Recovery{"encoder_gain", Family::kServo, 1, {{"gain_error", 0.1}}},
        Recovery{"encoder_offset", Family::kServo, 1, {{"offset", 0.05}}},
        Recovery{"encoder_eccentricity", Family::kServo, 1, {{"a", 0.1}, {"b", 0.1}}},
        Recovery{"encoder_eccentricity", Family::kTransmission, 2, {{"a", 0.1}, {"b", 0.1}}},
        Recovery{"transport_delay", Family::kServo, 1, {{"delay_s", 0.05}}},
        Recovery{"transport_delay", Family::kTransmission, 2, {{"delay_s", 0.02}}},
        Recovery{"servo_lag", Family::kServo, 1, {{"tau_s", 0.1}}},
        Recovery{"rate_limit", Family::kServo, 1, {{"rate", 0.05}}},
        Recovery{"torque_saturation", Family::kServo, 1, {{"limit", 0.05}}},
        Recovery{"deadzone", Family::kServo, 1, {{"width", 0.1}}},
        Recovery{"cross_joint_coupling", Family::kArm, 1, {{"k", 0.05}}},
        Recovery{"cross_joint_friction", Family::kArm, 1, {{"F", 0.1}}},
        Recovery{"cross_joint_friction", Family::kArm, 2, {{"c", 0.1}}},
        Recovery{"cross_joint_friction", Family::kArm, 3, {{"d", 0.1}}},
        Recovery{"cross_joint_rubbing", Family::kArm, 1, {{"F", 0.1}, {"n", 0.2}}},
        Recovery{"cross_joint_inertia", Family::kArm, 1, {{"J", 0.1}}},
        Recovery{"base_tilt", Family::kArm, 1, {{"y", 0.1}}},
        Recovery{"time_varying_gain", Family::kServo, 1, {{"rate", 0.1}}},
        Recovery{"motor_gain", Family::kServo, 1, {{"gain_error", 0.05}}},
        Recovery{"motor_gain", Family::kTorque, 2, {{"gain_error", 0.05}}},
        Recovery{"motor_gain", Family::kInverse, 2, {{"gain_error", 0.1}}},
        Recovery{"load_dependent_friction", Family::kInverse, 2, {{"mu", 0.2}}},
        Recovery{"gravity_error", Family::kInverse, 2, {{"beta", 0.05}}},
        Recovery{"quadratic_viscous_friction", Family::kInverse, 2, {{"c2", 0.2}}},
        Recovery{"asymmetric_viscous", Family::kTorque, 2, {{"d_sigma", 0.05}}},
        Recovery{"payload", Family::kTorque, 2, {{"mass", 0.05}}}),
    [](const testing::TestParamInfo<Recovery>& info) {
      return std::string(info.param.effect) + "_" + generator::FamilyName(info.param.family) + "_" +
             std::to_string(info.param.seed);
    });

}  // namespace
}  // namespace robostress::calibration
