#include "calibration/model/hypothesis.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kResolved = 1.5;  // [K] that a temperature must change by: sensors step by 1 K

double RmsOf(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value * value;
  return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
}

// Bounds and scale of a parameter of the declared model.
FreeParameter ModelParameter(const std::string& name, const JointModel& model,
                             const SignalScales& s, double inertia) {
  const double per_velocity = s.torque / s.velocity;
  if (name == "armature") return {name, std::max(inertia, model.armature), 0, 20};
  if (name == "mass_scale") return {name, 1, 0.05, 20};
  if (name == "damping") return {name, per_velocity, 0, 20};
  if (name == "frictionloss") return {name, s.torque, 0, 3};
  if (name == "servo.kp") return {name, model.servo.kp, 0.1, 10};
  if (name == "servo.kd") return {name, model.servo.kd > 0 ? model.servo.kd : per_velocity, 0, 10};
  if (name == "torque_offset") return {name, s.torque, -3, 3};
  if (name == "torque_gain") return {name, 1, 0.1, 10};
  if (name == "command_shift") return {name, 1, -0.6, 0.6};
  if (name == "force_lag") return {name, std::min(s.sample, 2e-3), -0.6, 1.1};
  return {name, s.position, -3, 3};  // position_offset
}

FreeParameter EffectFreeParameter(const EffectInfo& effect, size_t index, const SignalScales& s) {
  const EffectParameter& parameter = effect.parameters[index];
  return {absl::StrCat(effect.type, ".", parameter.name), ScaleOf(parameter.scale, s),
          parameter.lower, parameter.upper, parameter.inverse};
}

bool IsFree(const Hypothesis& h, const std::string& path) {
  return std::any_of(h.free.begin(), h.free.end(),
                     [&](const FreeParameter& known) { return known.path == path; });
}

// A parameter keeps its value and is no longer free.
void Forget(Hypothesis& h, const std::string& path) {
  for (size_t i = 0; i < h.free.size(); ++i) {
    if (h.free[i].path != path) continue;
    h.free.erase(h.free.begin() + static_cast<int>(i));
    const int rest = static_cast<int>(h.free.size() - i);
    h.x.segment(static_cast<int>(i), rest) = h.x.tail(rest).eval();
    h.x.conservativeResize(static_cast<int>(h.free.size()));
    return;
  }
}

}  // namespace

double ScaleOf(EffectScale scale, const SignalScales& s) {
  switch (scale) {
    case EffectScale::kOne:
      return 1;
    case EffectScale::kTorque:
    case EffectScale::kTorquePerSecond:
      return s.torque;
    case EffectScale::kPosition:
      return s.position;
    case EffectScale::kVelocity:
      return s.velocity;
    case EffectScale::kSample:
      return s.sample;
    case EffectScale::kTorquePerPosition:
      return s.torque / s.position;
    case EffectScale::kTorquePerPosition2:
      return s.torque / (s.position * s.position);
    case EffectScale::kTorquePerPosition3:
      return s.torque / (s.position * s.position * s.position);
    case EffectScale::kTorquePerVelocity:
      return s.torque / s.velocity;
    case EffectScale::kTorquePerVelocity2:
      return s.torque / (s.velocity * s.velocity);
    case EffectScale::kPayload:
      return s.payload;
    case EffectScale::kTorquePerAcceleration:
      return s.torque / s.acceleration;
    case EffectScale::kTorquePerKelvin:
      return s.torque / std::max(s.warming, kResolved);
    case EffectScale::kTorquePerVelocityKelvin:
      return s.torque / (s.velocity * std::max(s.warming, kResolved));
    case EffectScale::kColdest:
      return 1;
  }
  return 1;
}

SignalScales MeasureScales(const RigJoint& joint, const std::vector<JointTrack>& tracks) {
  SignalScales scales;
  double torque = 0, position = 0, velocity = 0, acceleration = 0, payload = 0;
  std::vector<double> temperatures;
  for (const JointTrack& track : tracks) {
    const JointRecord& record = track.record();
    const auto [low, high] = std::minmax_element(record.q_smooth.begin(), record.q_smooth.end());
    position = std::max(position, (*high - *low) / 2);
    velocity = std::max(velocity, RmsOf(record.dq));
    acceleration = std::max(acceleration, RmsOf(record.ddq));
    temperatures.insert(temperatures.end(), record.temperature.begin(), record.temperature.end());
    double drive = RmsOf(record.tau);
    if (record.tau.empty() && !record.command.empty()) {
      std::vector<double> asked(record.q.size());
      for (size_t i = 0; i < asked.size(); ++i) {
        asked[i] = joint.servo.kp * (record.command[i] - record.q_smooth[i]);
        if (joint.servo.type == Servo::Type::kDcMotor)
          asked[i] = joint.servo.kt / joint.servo.R *
                     std::clamp(asked[i], -joint.servo.vin, joint.servo.vin);
      }
      drive = RmsOf(asked);
    }
    torque = std::max(torque, drive);
    for (const PlantRow& row : track.rows)
      payload = std::max({payload,
                          std::abs(row.payload_gravity.a) + std::abs(row.payload_gravity.b) +
                              std::abs(row.payload_gravity.c),
                          9.81 * std::sqrt(row.payload_inertia)});
    scales.sample = track.log->dt;
  }
  scales.torque = std::max(torque, 1e-9);
  scales.position = std::max(position, 1e-9);
  scales.velocity = std::max(velocity, 1e-9);
  scales.acceleration = std::max(acceleration, 1e-9);
  scales.payload = scales.torque / std::max(payload, 1e-9);
  if (!temperatures.empty()) {
    const auto [cold, warm] = std::minmax_element(temperatures.begin(), temperatures.end());
    scales.coldest = *cold;
    scales.warming = *warm - *cold;
  }
  return scales;
}

absl::StatusOr<Hypothesis> DeclaredHypothesis(const RigJoint& joint, const JointModel& model,
                                              const SignalScales& scales, double inertia) {
  Hypothesis h;
  h.model = model;
  for (const std::string& name : joint.fit)
    h.free.push_back(ModelParameter(name, model, scales, inertia));
  if (model.input == JointInput::kPositionTarget || model.input == JointInput::kTorque) {
    for (const char* name : {"command_shift", "force_lag"})
      if (std::find(joint.fit.begin(), joint.fit.end(), name) == joint.fit.end())
        h.free.push_back(ModelParameter(name, model, scales, inertia));
  }
  for (size_t i = 0; i < joint.effects.size(); ++i) {
    const EffectInfo& info = *model.effects[i].info;
    for (const std::string& name : joint.effects[i].fit) {
      RS_ASSIGN_OR_RETURN(const int index, FindParameter(info, name));
      h.free.push_back(EffectFreeParameter(info, index, scales));
    }
  }
  h.x.resize(static_cast<int>(h.free.size()));
  for (size_t i = 0; i < h.free.size(); ++i) {
    FreeParameter& parameter = h.free[i];
    RS_ASSIGN_OR_RETURN(const double* value, FindValue(h.model, parameter.path));
    const double x = parameter.FromValue(*value);
    parameter.lower = std::min(parameter.lower, x - std::abs(x));
    parameter.upper = std::max(parameter.upper, x + std::abs(x));
    h.x[static_cast<int>(i)] = x;
  }
  return h;
}

std::vector<Hypothesis> WithEffect(const Hypothesis& base, const EffectInfo& effect,
                                   const SignalScales& scales, int partner) {
  Hypothesis h = base;
  if (effect.type == "transport_delay" || effect.type == "servo_lag") {
    Forget(h, "command_shift");
    h.model.command_shift = 0;
  }
  EffectInstance instance{&effect, {}, partner};
  std::vector<size_t> free;
  const bool has_damping = IsFree(h, "damping");
  for (size_t i = 0; i < effect.parameters.size(); ++i) {
    const EffectParameter& parameter = effect.parameters[i];
    const double scale = parameter.fixed ? 1 : ScaleOf(parameter.scale, scales);
    instance.values.push_back(parameter.scale == EffectScale::kColdest
                                  ? scales.coldest
                                  : parameter.starts.front() * scale);
    if (parameter.fixed) continue;
    // Of two numbers for the same no log could tell which.
    if (has_damping && parameter.name == std::string("sigma_v")) {
      instance.values.back() = 0;
      continue;
    }
    free.push_back(i);
    h.free.push_back(EffectFreeParameter(effect, i, scales));
  }
  h.model.effects.push_back(std::move(instance));
  // Every combination of starts.
  std::vector<Hypothesis> result;
  std::vector<size_t> choice(free.size(), 0);
  const int first = static_cast<int>(h.x.size());
  while (true) {
    Hypothesis next = h;
    next.x.resize(static_cast<int>(h.free.size()));
    next.x.head(first) = h.x;
    for (size_t i = 0; i < free.size(); ++i)
      next.x[first + static_cast<int>(i)] = effect.parameters[free[i]].starts[choice[i]];
    result.push_back(std::move(next));
    size_t digit = 0;
    while (digit < free.size() && ++choice[digit] == effect.parameters[free[digit]].starts.size())
      choice[digit++] = 0;
    if (digit == free.size()) return result;
  }
}

Hypothesis WithLateParameters(const Hypothesis& base, const std::vector<std::string>& types) {
  Hypothesis h = base;
  const auto add = [&h](FreeParameter free, double value) {
    if (IsFree(h, free.path)) return;
    h.x.conservativeResize(h.x.size() + 1);
    h.x[h.x.size() - 1] = free.FromValue(value);
    h.free.push_back(std::move(free));
  };
  for (const EffectInstance& effect : base.model.effects) {
    if (std::find(types.begin(), types.end(), effect.info->type) == types.end()) continue;
    for (size_t i = 0; i < effect.info->parameters.size(); ++i)
      if (effect.info->parameters[i].late)
        add(EffectFreeParameter(*effect.info, i, {}), effect.values[i]);
    // Beside a lag, whether commands hold over a row shows in what is left.
    if (effect.info->type == "servo_lag")
      add(ModelParameter("command_shift", h.model, {}, 0), h.model.command_shift);
  }
  return h;
}

bool IsLogged(const EffectInfo& effect, const SignalScales& scales) {
  return !effect.thermal || scales.warming >= kResolved;
}

Hypothesis WithoutEffect(const Hypothesis& h, const std::string& type) {
  Hypothesis result = h;
  for (const FreeParameter& parameter : h.free) {
    if (absl::StartsWith(parameter.path, type + ".")) Forget(result, parameter.path);
  }
  std::erase_if(result.model.effects,
                [&](const EffectInstance& effect) { return effect.info->type == type; });
  return result;
}

Hypothesis FixedAtZero(const Hypothesis& h, int free) {
  Hypothesis result = h;
  const std::string path = h.free[free].path;
  const absl::StatusOr<double*> value = FindValue(result.model, path);
  RS_CHECK(value.ok());
  **value = 0;
  Forget(result, path);
  return result;
}

JointModel ModelAt(const Hypothesis& hypothesis, const Eigen::VectorXd& x) {
  JointModel model = hypothesis.model;
  for (size_t i = 0; i < hypothesis.free.size(); ++i) {
    const absl::StatusOr<double*> value = FindValue(model, hypothesis.free[i].path);
    RS_CHECK(value.ok());
    **value = hypothesis.free[i].ToValue(x[static_cast<int>(i)]);
  }
  return model;
}

}  // namespace robostress::calibration
