#include "common/joint_errors/bam_parameters.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

constexpr uint64_t kMostBytes = 1 << 20;
constexpr double kFastest = 10, kVelocityStep = 0.01;  // [rad/s]
constexpr int kLoads = 20;                             // of either sign

struct BamField {
  const char* name;
  double BamParameters::*member;
  std::vector<int> models;  // that have it; others do not read it
  bool positive = false;    // 0 is refused: it is divided by
  bool needed = true;
};

const std::vector<BamField>& BamFields() {
  using P = BamParameters;
  static const auto& fields = *new std::vector<BamField>{
      {"kt", &P::kt, {1, 2, 3, 4, 5, 6}, true, false},
      {"R", &P::R, {1, 2, 3, 4, 5, 6}, true, false},
      {"armature", &P::armature, {1, 2, 3, 4, 5, 6}, true, false},
      {"current_limit", &P::current_limit, {1, 2, 3, 4, 5, 6}, true, false},
      {"friction_base", &P::friction_base, {1, 2, 3, 4, 5, 6}},
      {"friction_viscous", &P::friction_viscous, {1, 2, 3, 4, 5, 6}},
      {"friction_stribeck", &P::friction_stribeck, {2, 4, 5, 6}},
      {"dtheta_stribeck", &P::dtheta_stribeck, {2, 4, 5, 6}, true},
      {"alpha", &P::alpha, {2, 4, 5, 6}, true},
      {"load_friction_base", &P::load_friction_base, {3, 4}},
      {"load_friction_stribeck", &P::load_friction_stribeck, {4}},
      {"load_friction_motor", &P::load_friction_motor, {5, 6}},
      {"load_friction_external", &P::load_friction_external, {5, 6}},
      {"load_friction_motor_stribeck", &P::load_friction_motor_stribeck, {5, 6}},
      {"load_friction_external_stribeck", &P::load_friction_external_stribeck, {5, 6}},
      {"load_friction_motor_quad", &P::load_friction_motor_quad, {6}},
      {"load_friction_external_quad", &P::load_friction_external_quad, {6}}};
  return fields;
}

const std::map<std::string, const char*>& KnownUnused() {
  static const auto& known = *new std::map<std::string, const char*>{
      {"q_offset", "of BAM's test bench"},
      {"command_delay", "of BAM's bus [s]; transport_delay adds yours"},
      {"error_gain_ratio", "of the servo's controller: multiply the rig's kp by it"},
      {"ratio", "of the servo's controller: multiply the rig's kp by it"},
      {"max_torque", "of the servo's controller [Nm]: the rig's torque_limit"},
      {"max_velocity",
       "of the servo's controller [rad/s]: its target moves no faster; command no faster"}};
  return known;
}

// Whose control_unit() in BAM is "amps" (bam/erob, bam/feetech, bam/dynamixel) or "N.m"
// (bam/unitree): their torque does not fall with speed as that of a motor at a voltage.
bool IsVoltageControlled(const std::string& actuator) {
  for (const char* other : {"erob80_50", "erob80_100", "feetech_hls", "xl330i", "unitree_go1"})
    if (actuator == other) return false;
  return true;
}

class BamReader {
 public:
  BamReader(std::string file, const nlohmann::json& root) : root_(root) {
    p_.file = std::move(file);
  }

  absl::StatusOr<BamParameters> Read() {
    RS_ASSIGN_OR_RETURN(const std::string model, Text("model"));
    if (model.size() != 2 || model[0] != 'm' || model[1] < '1' || model[1] > '6')
      return Wrong("model", "must be m1 to m6");
    p_.model = model[1] - '0';
    RS_ASSIGN_OR_RETURN(p_.actuator, Text("actuator"));
    for (const BamField& field : BamFields()) RS_RETURN_IF_ERROR(Take(field));
    for (const auto& [key, value] : root_.items()) {
      if (read_.count(key) > 0) continue;
      const auto known = KnownUnused().find(key);
      p_.unused.push_back(absl::StrCat(
          key, " ", value.dump(), ": ",
          known == KnownUnused().end() ? absl::StrCat("model ", model, " of BAM has no such term")
                                       : known->second));
    }
    return std::move(p_);
  }

 private:
  absl::Status Wrong(const std::string& field, const std::string& what) const {
    const std::string value = root_.contains(field) ? absl::StrCat("is ", root_[field].dump(), ", ")
                                                    : std::string("is missing, ");
    return absl::InvalidArgumentError(absl::StrCat(p_.file, ": ", field, ": ", value, what,
                                                   "; correct it or fit with BAM again"));
  }
  absl::StatusOr<std::string> Text(const std::string& field) {
    read_[field] = true;
    if (!root_.contains(field) || !root_[field].is_string()) return Wrong(field, "must be a text");
    return root_[field].get<std::string>();
  }
  absl::Status Take(const BamField& field) {
    if (std::count(field.models.begin(), field.models.end(), p_.model) == 0)
      return absl::OkStatus();
    read_[field.name] = true;
    if (!root_.contains(field.name) && !field.needed) return absl::OkStatus();
    const bool is_number = root_.contains(field.name) && root_[field.name].is_number();
    const double value = is_number ? root_[field.name].get<double>() : 0;
    if (!is_number || !std::isfinite(value) || (field.positive ? value <= 0 : value < 0))
      return Wrong(field.name,
                   absl::StrCat("must be a number ", field.positive ? "above 0" : "of at least 0"));
    p_.*field.member = value;
    return absl::OkStatus();
  }

  const nlohmann::json& root_;
  std::map<std::string, bool> read_;
  BamParameters p_;
};

double Stribeck(double dq, double velocity, double exponent) {
  return std::exp(-std::pow(std::abs(dq / velocity), exponent));
}

// Of the library's exponent 2, with the same area under the curve.
double StribeckVelocity(const BamParameters& p) {
  return p.dtheta_stribeck * std::tgamma(1 + 1 / p.alpha) / std::tgamma(1.5);
}
double OfMotor(const BamParameters& p) { return p.load_friction_motor + p.load_friction_base; }
double OfGravity(const BamParameters& p) { return p.load_friction_external + p.load_friction_base; }

double MappedDryFriction(const BamParameters& p, double motor, double gravity, double dq) {
  return p.friction_base + p.friction_stribeck * Stribeck(dq, StribeckVelocity(p), 2) +
         OfMotor(p) * std::abs(motor) + OfGravity(p) * std::abs(gravity);
}

}  // namespace

absl::StatusOr<BamParameters> ParseBamParameters(const std::string& file, const std::string& json) {
  const absl::StatusOr<nlohmann::json> root = ParseJsonObject(json);
  if (!root.ok())
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", root.status().message(), "; give a file that BAM's fit wrote"));
  return BamReader(file, *root).Read();
}

absl::StatusOr<BamParameters> ReadBamParameters(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(file, kMostBytes));
  return ParseBamParameters(file, text);
}

double BamDryFriction(const BamParameters& p, double motor, double external, double dq) {
  const double together = std::abs(external - motor);
  const double gear = p.load_friction_base * together +
                      std::abs(p.load_friction_external * external - p.load_friction_motor * motor);
  double at_rest = p.friction_stribeck + p.load_friction_stribeck * together +
                   std::abs(p.load_friction_external_stribeck * external -
                            p.load_friction_motor_stribeck * motor);
  const auto sign = [](double x) { return (x > 0) - (x < 0); };
  if (sign(motor) != sign(external)) {
    if (std::abs(external) < std::abs(motor))
      at_rest += p.load_friction_external_quad * external * external;
    if (std::abs(external) > std::abs(motor)) at_rest += p.load_friction_motor_quad * motor * motor;
  }
  return p.friction_base + gear + Stribeck(dq, p.dtheta_stribeck, p.alpha) * at_rest;
}

BamEffects EffectsOfBam(const BamParameters& p) {
  BamEffects mapped;
  const auto add = [&](const char* type, std::vector<double> values) {
    mapped.effects.push_back({0, type, std::move(values), -1});
  };
  if (p.friction_base + p.friction_stribeck + p.friction_viscous > 0)
    add("stribeck_friction", {p.friction_base, p.friction_base + p.friction_stribeck,
                              StribeckVelocity(p), p.friction_viscous});
  if (OfMotor(p) > 0) add("load_dependent_friction", {OfMotor(p)});
  if (OfGravity(p) > 0) add("gravity_dependent_friction", {OfGravity(p)});
  const auto leave_out = [&](const char* name, double value, const char* why) {
    if (value > 0) mapped.left_out.push_back(absl::StrFormat("%s %g: %s", name, value, why));
  };
  constexpr char kAtRest[] = "friction by load does not grow towards rest in this library";
  constexpr char kSquared[] = "friction is linear in the load in this library";
  leave_out("load_friction_stribeck", p.load_friction_stribeck, kAtRest);
  leave_out("load_friction_motor_stribeck", p.load_friction_motor_stribeck, kAtRest);
  leave_out("load_friction_external_stribeck", p.load_friction_external_stribeck, kAtRest);
  leave_out("load_friction_motor_quad", p.load_friction_motor_quad, kSquared);
  leave_out("load_friction_external_quad", p.load_friction_external_quad, kSquared);
  mapped.left_out.insert(mapped.left_out.end(), p.unused.begin(), p.unused.end());
  return mapped;
}

BamDifference LargestBamDifference(const BamParameters& p, double load) {
  BamDifference largest;
  for (double dq = 0; dq <= kFastest; dq += kVelocityStep) {
    for (int i = 0; i <= kLoads; ++i) {
      for (int k = -kLoads; k <= kLoads; ++k) {
        const double motor = load * i / kLoads, external = load * k / kLoads;
        const double difference = std::abs(MappedDryFriction(p, motor, external, dq) -
                                           BamDryFriction(p, motor, external, dq));
        double& of_kind = i == 0 && k == 0 ? largest.unloaded
                          : k <= 0         ? largest.opposing
                                           : largest.helping;
        of_kind = std::max(of_kind, difference);
      }
    }
  }
  return largest;
}

absl::StatusOr<ScenarioFile> ScenarioOfBam(const BamParameters& p, const std::vector<int>& joints,
                                           const RobotDescription& robot) {
  ScenarioFile scenario;
  scenario.title = absl::StrFormat("Servo %s, BAM m%d", p.actuator, p.model);
  for (const int joint : joints) {
    for (ScenarioEffect effect : EffectsOfBam(p).effects) {
      effect.joint = joint;
      scenario.effects.push_back(std::move(effect));
    }
  }
  RS_RETURN_IF_ERROR(ParseScenarioFile(p.file, WriteScenarioFile(scenario, robot), robot).status());
  return scenario;
}

std::string RigJointOfBam(const BamParameters& p, absl::string_view joint) {
  std::string text = absl::StrCat("  - name: ", joint, "\n    input: position_target\n");
  if (!IsVoltageControlled(p.actuator)) {
    const std::string limit = p.kt > 0 && p.current_limit > 0
                                  ? absl::StrFormat(", torque_limit: %.9g", p.kt * p.current_limit)
                                  : "";
    absl::StrAppend(
        &text, "    servo: {kp: FILL_IN, kd: FILL_IN", limit, "}  # [Nm/rad], [Nm s/rad]",
        p.kt > 0 ? absl::StrFormat(": %.9g Nm/A times those in amperes", p.kt) : "", "\n");
  } else if (p.kt > 0 && p.R > 0) {
    absl::StrAppend(&text, absl::StrFormat("    servo: {type: dc_motor, kp: FILL_IN, kt: %.9g, R: "
                                           "%.9g, vin: FILL_IN}  # [V/rad], [Nm/A], [ohm], [V]\n",
                                           p.kt, p.R));
  } else {
    text += "    servo: {kp: FILL_IN, kd: FILL_IN}  # [Nm/rad], [Nm s/rad]\n";
  }
  if (p.armature > 0)
    absl::StrAppend(&text,
                    absl::StrFormat("    parameters: {armature: %.9g}  # [kg m^2]\n", p.armature));
  text += "    effects:  # [Nm], [rad/s], [Nm s/rad], [1]\n";
  for (const ScenarioEffect& effect : EffectsOfBam(p).effects) {
    const EffectInfo& info = **FindEffect(effect.type);
    std::vector<std::string> values;
    for (size_t i = 0; i < effect.values.size(); ++i)
      values.push_back(absl::StrFormat("%s: %.9g", info.parameters[i].name, effect.values[i]));
    absl::StrAppend(&text, "      - {type: ", effect.type, ", ", absl::StrJoin(values, ", "),
                    "}\n");
  }
  return text;
}

}  // namespace robostress
