#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "calibration/search/calibration_report.h"

namespace robostress::calibration {

// A report with figures like those of the EMPS axis: direction-dependent viscous friction is
// missing and found. Signals are made up.
inline CalibrationReport AttributedReport() {
  CalibrationReport report;
  report.rig = "emps";
  report.rig_file = "rigs/emps/rig.yaml";
  report.model = "emps.xml";
  report.verdict = Verdict::kAttributed;
  report.because =
      "asymmetric_viscous at slider explains 68 % of the held-out error in excess of noise, beats "
      "the best of 999 surrogates and keeps its value in every fold.";
  report.n_surrogates = 999;
  report.elapsed_s = 141.3;
  report.model_out = "rig_after.yaml";
  report.logs = {
      {"train.csv", "fit", "", 24841, 24.84, {}},
      {"pulses.csv",
       "held_out",
       "pulses",
       24841,
       24.84,
       {"clock: 3 gaps of one row, interpolated", "tau_slider saturates in 0.4 % of rows"}}};

  JointReport joint;
  joint.joint = "slider";
  joint.input = "torque";
  joint.unit = "m";
  joint.verdict = report.verdict;
  joint.because = report.because;
  joint.fit = {0.538e-3, 0.198e-3, 0.012e-3, true};
  joint.cross_validated = {0.561e-3, 0.224e-3, 0.012e-3, true};
  joint.held_out = {0.724e-3, 0.493e-3, 0.013e-3, true};
  joint.full_run = {9.60e-3, 9.18e-3, 0.013e-3, true};
  joint.excess_explained = 0.325;
  joint.declared_parameters = {{"mass", "kg", 95.31, 0.12, false},
                               {"stribeck_friction.Fc", "N", 20.35, 0.21, false},
                               {"stribeck_friction.sigma_v", "N s/m", 203.97, 1.9, false},
                               {"encoder_zero", "N", -3.17, 0.08, false},
                               {"servo.kp", "N/m", 160.18, 0, false}};
  joint.after_parameters = joint.declared_parameters;
  joint.after_parameters[0].value = 95.08;
  joint.after_parameters[3].value = -0.21;
  joint.mimics_exposed = {
      "torque_offset falls from -3.17 to -0.21 N: it stood in for asymmetric_viscous"};

  RoundReport first;
  first.cv_error = 0.561e-3;
  first.null_95 = 0.128, first.null_99 = 0.151;
  first.candidates = {
      {"asymmetric_viscous", 0.97, 0.276, 0.001, 0.60, true, true, ""},
      {"time_drift_friction", 0.96, 0.121, 0.07, 0.011, true, false, "within chance"},
      {"load_dependent_friction", 0.15, 0.09, 0.21, 0.03, true, false, "gain in 2 of 4 folds"},
      {"presliding_hysteresis", 0.55, 0.071, 0.4, 0, false, false, "within chance"},
      {"transport_delay", 0.44, 0.041, 0.8, 0, false, false, "within chance"},
      {"servo_lag", 0.43, 0.040, 0.8, 0, false, false, "within chance"},
      {"backlash", 0.31, 0.012, 0.99, 0, false, false, "within chance"},
  };
  RoundReport second;
  second.base = {"asymmetric_viscous"};
  second.cv_error = 0.224e-3;
  second.null_95 = 0.010, second.null_99 = 0.017;
  second.candidates = {
      {"position_periodic_torque", 0.99, 0.015, 0.03, 0.018, true, false, "below 3 %"},
      {"stribeck_friction", 0.2, 0.009, 0.2, 0, false, false, "within chance"}};
  joint.rounds = {first, second};

  AddedEffectReport effect;
  effect.type = "asymmetric_viscous";
  effect.parameters = {{"d_sigma", "N s/m", -37.02, 0.84, false}};
  effect.held_out_error_before = 0.724e-3, effect.held_out_error_after = 0.493e-3;
  effect.cv_gain = 0.60, effect.p_value = 0.001;
  joint.effects = {effect};
  joint.groups = {{"transport_delay", "servo_lag"}};
  joint.not_testable = {{"quadratic_viscous_friction", 0.07}, {"asymmetric_coulomb", 0.09}};
  joint.residual_declared = {false, 0.54, 0.03, "velocity: 0.41 of the variance"};
  joint.residual_after = {false, 0.13, 0.03, "position: 0.06 of the variance"};

  const auto curve = [&](const char* against, const char* unit, double low, double high,
                         auto declared, auto after, double explained, double left) {
    StructureCurve c;
    c.against = against, c.unit = unit;
    for (int i = 0; i < 24; ++i) {
      const double u = (i + 0.5) / 24;
      c.x.push_back(low + (high - low) * u);
      c.declared.push_back(declared(u));
      c.after.push_back(after(u));
    }
    c.explained_declared = explained, c.explained_after = left, c.limit = 0.031;
    joint.structure.push_back(c);
  };
  const auto ripple = [](double u) { return 4e-5 * std::sin(19 * u); };
  curve(
      "position", "m", 0, 0.24, [](double u) { return 3e-4 * std::sin(5 * u); }, ripple, 0.12,
      0.06);
  curve(
      "velocity", "m/s", -0.11, 0.11, [](double u) { return 9e-4 * std::abs(2 * u - 1) - 4e-4; },
      [](double u) { return 2e-5 * std::cos(14 * u); }, 0.41, 0.02);
  curve(
      "load", "N", -40, 40, [](double u) { return 2e-4 * (u - 0.5); }, ripple, 0.08, 0.01);
  curve(
      "time", "s", 0, 24.8, [](double u) { return 1e-4 * std::cos(9 * u); }, ripple, 0.05, 0.02);
  curve(
      "frequency", "Hz", 0.5, 120, [](double u) { return 4e-4 / (1 + 400 * u * u); },
      [](double u) { return 9e-5 / (1 + 90 * u * u); }, 0, 0);
  joint.structure.back().limit = 0;

  ExampleReport example;
  example.log = "pulses.csv";
  for (int i = 0; i < 4000; ++i) {
    const double t = 2 + 1e-3 * i, q = 0.1 + 0.09 * std::sin(2.2 * t),
                 dq = 0.198 * std::cos(2.2 * t);
    const double saw = std::fmod(t, 0.5), noise = 1.2e-5 * std::sin(977.0 * i * i);
    example.t.push_back(t);
    example.measured.push_back(q + noise);
    example.declared.push_back(q + 9e-3 * saw * saw * std::abs(dq) / 0.198 - 4e-4 * saw);
    example.after.push_back(q + 2.4e-3 * saw * saw * std::sin(7 * t));
  }
  joint.examples = {example};
  report.joints = {joint};
  return report;
}

}  // namespace robostress::calibration
