#include <algorithm>
#include <cmath>

#include "common/check.h"
#include "tests/calibration/generator/hidden_effect.h"

namespace robostress::generator {
namespace {

constexpr double kFastest = 4;  // times the mean speed

}  // namespace

HiddenEffect DrawEffect(const std::string& type, Size size, const Signals& s,
                        RandomStream& random) {
  const auto pick = [&](double small, double medium, double large) {
    const double value = size == Size::kSmall ? small : size == Size::kMedium ? medium : large;
    return value * std::exp(random.Uniform(-0.2, 0.2));
  };
  const auto sign = [&] { return random.Uniform() < 0.5 ? -1.0 : 1.0; };
  const double share = pick(0.04, 0.10, 0.25), torque = share * s.torque;
  // What it takes off dry friction must be there.
  const double friction = std::min(torque, 0.8 * s.base_friction);
  const double way = pick(0.004, 0.012, 0.03) * s.range;
  const double wavelength = random.Uniform(0.25, 0.7) * s.range;
  const double phase = random.Uniform(0, 2 * M_PI);
  const auto wave = [&](double amplitude) -> std::map<std::string, double> {
    return {{"a", amplitude * std::cos(phase)},
            {"b", amplitude * std::sin(phase)},
            {"wavelength", wavelength}};
  };
  const double lag = std::max(pick(0.003, 0.008, 0.02), 0.5 * s.dt);
  HiddenEffect e{type, 0, {}};
  auto& p = e.parameters;
  if (type == "stribeck_friction") {
    p = {{"Fc", torque}, {"Fs", 1.7 * torque}, {"vs", 0.15 * s.speed}, {"sigma_v", 0}};
  } else if (type == "asymmetric_coulomb") {
    p = {{"dFc", sign() * friction}};
  } else if (type == "asymmetric_viscous") {
    // The joint rubs both ways at the speeds that it reaches.
    const double resists = 0.8 * s.viscous + 0.8 * s.base_friction / (kFastest * s.speed);
    p = {{"d_sigma", sign() * std::min(torque / s.speed, resists)}};
  } else if (type == "load_dependent_friction") {
    p = {{"mu", share}};
  } else if (type == "gravity_dependent_friction") {
    p = {{"mu", 1.5 * torque / std::max(s.holding, 1e-9)}};
  } else if (type == "temperature_friction") {
    // What falls as the joint warms must be there.
    const auto lost = [&](double there) {
      return std::min(torque / s.warming, 0.9 * there / s.warmest);
    };
    const bool dry = random.Uniform() < 0.5;
    p = {{"c", dry ? -lost(s.base_friction) : 0},
         {"v", dry ? 0 : -lost(s.viscous * s.speed) / s.speed}};
  } else if (type == "quadratic_viscous_friction") {
    p = {{"c2", torque / (s.speed * s.speed)}};
  } else if (type == "time_drift_friction") {
    p = {{"rate", (random.Uniform() < 0.7 ? 2 * torque : -friction) / s.duration}};
  } else if (type == "presliding_hysteresis") {
    p = {{"F", 1.5 * torque}, {"x_s", random.Uniform(0.02, 0.06) * s.range}};
  } else if (type == "position_dependent_friction") {
    p = wave(friction);
  } else if (type == "gravity_error") {
    p = {{"beta", sign() * 1.5 * share}};
  } else if (type == "payload") {
    p = {{"mass", 1.5 * share * s.mass}};
  } else if (type == "position_periodic_torque") {
    p = wave(torque);
  } else if (type == "position_dependent_torque") {
    const double c = sign() * torque / s.range;
    p = {{"c1", c * random.Uniform(-0.5, 0.5)},
         {"c2", sign() * 1.5 * c / s.range},
         {"c3", c * random.Uniform(1, 2) / (s.range * s.range)}};
  } else if (type == "cable_spring") {
    p = {{"k", 1.5 * torque / s.range}, {"q0", random.Uniform(-0.5, 0.5) * s.range}};
  } else if (type == "transmission_error") {
    p = wave(way);
  } else if (type == "backlash") {
    p = {{"B", way}};
  } else if (type == "compliance") {
    p = {{"K", s.torque / way},
         {"frequency", 10 * std::exp(random.Uniform(0, 1.2))},
         {"zeta", random.Uniform(0.4, 1)}};
  } else if (type == "encoder_gain") {
    p = {{"gain_error", sign() * pick(0.01, 0.03, 0.08)}};
  } else if (type == "encoder_offset") {
    p = {{"offset", sign() * pick(0.01, 0.03, 0.08) * std::min(1.0, 2 * s.range)}};
  } else if (type == "encoder_eccentricity") {
    const double size = pick(0.01, 0.03, 0.08) * std::min(1.0, 2 * s.range);
    p = {{"a", size * std::cos(phase)}, {"b", size * std::sin(phase)}};
  } else if (type == "transport_delay") {
    p = {{"delay_s", lag}};
  } else if (type == "servo_lag") {
    p = {{"tau_s", 1.3 * lag}};
  } else if (type == "rate_limit") {
    p = {{"rate", s.peak_command_speed * pick(0.75, 0.55, 0.35)}};
  } else if (type == "torque_saturation") {
    p = {{"limit", std::max(s.peak_torque * pick(0.8, 0.6, 0.45), 1.1 * s.holding)}};
  } else if (type == "deadzone") {
    p = {{"width", torque}};
  } else if (type == "cross_joint_coupling") {
    p = {{"k", sign() * 1.5 * torque / s.range}};
  } else if (type == "cross_joint_friction") {
    const int form = random.UniformInt(3);
    p = {{"F", form == 0 ? sign() * torque : 0},
         {"d", form == 1 ? sign() * torque / s.other_speed : 0},
         {"c", form == 2 ? torque / s.other_speed : 0}};
  } else if (type == "cross_joint_rubbing") {
    p = {{"F", friction}, {"n", sign() * random.Uniform(0.7, 1.4)}};
  } else if (type == "cross_joint_inertia") {
    p = {{"J", sign() * torque / s.other_acceleration}};
  } else if (type == "base_tilt") {
    p = {{"x", 0}, {"y", sign() * pick(0.01, 0.03, 0.08)}};
  } else if (type == "time_varying_gain") {
    p = {{"rate", sign() * 1.5 * share / s.duration}};
  } else if (type == "motor_gain") {
    p = {{"gain_error", sign() * share}};
  } else if (type == "dwell_hot_spot") {
    p = {{"q", random.Uniform(-0.4, 0.4) * s.range},
         {"width", 0.25 * s.range},
         {"F", 5 * torque},
         {"growth_s", 0.4},
         {"decay_s", 1.5}};
  } else if (type == "speeding_friction") {
    p = {{"F", friction}, {"memory_s", 0.05}};
  } else if (type == "current_ripple") {
    p = wave(1.5 * share);
  } else if (type == "second_mass") {
    p = {{"share", random.Uniform(0.3, 0.6)},
         {"frequency", pick(16, 9, 5)},
         {"zeta", random.Uniform(0.03, 0.1)}};
  } else if (type == "random_walk_torque") {
    p = {{"size", torque}, {"memory_s", random.Uniform(0.3, 2)}};
  } else if (type == "quantised_command") {
    p = {{"step", 4 * way}};
  } else if (type == "intermittent_slip") {
    p = {{"step", 3 * way}, {"torque", 1.2 * s.torque}, {"per_second", 2}};
  } else if (type == "thermal_friction") {
    p = {{"F", 2 * torque}, {"per_warmth", 1.5}, {"speed", s.speed}, {"time_s", s.duration / 4}};
  } else if (type == "delay_jitter") {
    p = {{"mean_s", lag}, {"spread_s", lag}};
  }
  RS_CHECK(!p.empty());
  return e;
}

}  // namespace robostress::generator
