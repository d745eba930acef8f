#include "common/joint_errors/scenario_file.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/plain_line.h"
#include "common/status_macros.h"
#include "common/yaml_document.h"

namespace robostress {
namespace {

constexpr char kEnding[] = ".yaml";
constexpr char kCoupledKey[] = "joint";
// Of an arm's size: beyond any drive, and far from where a quotient overflows to a torque that is
// no number.
constexpr double kLeastDivisor = 1e-6, kMostLimit = 1e12;

// Sizes of the arm, of which the library's bounds are multiples.
double ArmScale(EffectScale scale, const RobotDescription& robot, int joint) {
  const double torque = robot.joints[joint].torque_limit;
  const double velocity = robot.joints[joint].max_velocity;
  constexpr double kPosition = M_PI;
  constexpr double kAccelerating_s = 0.25;  // to the largest velocity
  constexpr double kWarming = 20;           // [K] over a shift
  switch (scale) {
    case EffectScale::kOne:
      return 1;
    case EffectScale::kTorque:
    case EffectScale::kTorquePerSecond:
      return torque;
    case EffectScale::kPosition:
      return kPosition;
    case EffectScale::kVelocity:
      return velocity;
    case EffectScale::kSample:
      return robot.control_period_s;
    case EffectScale::kTorquePerPosition:
      return torque / kPosition;
    case EffectScale::kTorquePerPosition2:
      return torque / std::pow(kPosition, 2);
    case EffectScale::kTorquePerPosition3:
      return torque / std::pow(kPosition, 3);
    case EffectScale::kTorquePerVelocity:
      return torque / velocity;
    case EffectScale::kTorquePerVelocity2:
      return torque / std::pow(velocity, 2);
    case EffectScale::kPayload:
      return torque / (9.81 * robot.reach);
    case EffectScale::kTorquePerAcceleration:
      return torque / (velocity / kAccelerating_s);
    case EffectScale::kTorquePerKelvin:
      return torque / kWarming;
    case EffectScale::kTorquePerVelocityKelvin:
      return torque / (velocity * kWarming);
    case EffectScale::kColdest:
      return 1;
  }
  return 1;
}

class Parser {
 public:
  Parser(std::string file, const RobotDescription& robot) : file_(std::move(file)), robot_(robot) {}

  absl::StatusOr<ScenarioFile> Parse(const YAML::Node& root) const {
    ScenarioFile scenario;
    RS_RETURN_IF_ERROR(CheckKeys(root, "", {"title", "base", "joints"}));
    if (root["title"]) {
      RS_ASSIGN_OR_RETURN(scenario.title, Text(root["title"], "title"));
      if (!IsPlainLine(scenario.title))
        return Error("title", absl::StrCat("is '", PlainLine(scenario.title),
                                           "' with line breaks or control characters, must be a "
                                           "line of text: it heads the rows of tables"));
    }
    if (root["base"]) {
      RS_ASSIGN_OR_RETURN(scenario.base, Text(root["base"], "base"));
    }
    const std::vector<std::string> known = ScenarioNames();
    if (std::find(known.begin(), known.end(), scenario.base) == known.end())
      return Error("base", absl::StrCat("is '", scenario.base, "', must be one of ",
                                        absl::StrJoin(known, ", ")));
    const YAML::Node joints = root["joints"];
    if (!joints || !joints.IsSequence())
      return Error("joints", "must be a list; [] for a scenario without effects");
    for (size_t i = 0; i < joints.size(); ++i)
      RS_RETURN_IF_ERROR(ReadJoint(joints[i], absl::StrCat("joints[", i, "]"), scenario));
    return scenario;
  }

 private:
  absl::Status Error(const std::string& key, const std::string& what) const {
    return absl::InvalidArgumentError(absl::StrCat(file_, ": ", key, ": ", what));
  }
  absl::Status CheckKeys(const YAML::Node& node, const std::string& path,
                         const std::vector<std::string>& allowed) const {
    const std::string place = path.empty() ? "the file" : path;
    if (!node.IsMap())
      return Error(place, absl::StrCat("must be a map with ", absl::StrJoin(allowed, ", ")));
    std::set<std::string> seen;
    for (const auto& pair : node) {
      const std::string key = pair.first.Scalar();
      if (std::find(allowed.begin(), allowed.end(), key) == allowed.end())
        return Error(
            place, absl::StrCat("unknown key '", key, "'; known: ", absl::StrJoin(allowed, ", ")));
      if (!seen.insert(key).second)
        return Error(place, absl::StrCat("key '", key, "' is given twice; remove one"));
    }
    return absl::OkStatus();
  }
  absl::StatusOr<std::string> Text(const YAML::Node& node, const std::string& path) const {
    if (!node || !node.IsScalar() || node.Scalar().empty())
      return Error(path, "is missing or no text");
    return node.Scalar();
  }
  absl::StatusOr<double> Number(const YAML::Node& node, const std::string& path) const {
    double value = 0;
    if (!node.IsScalar() || !YAML::convert<double>::decode(node, value) || !std::isfinite(value))
      return Error(path, absl::StrCat("is '", node.IsScalar() ? node.Scalar() : "no scalar",
                                      "', must be a finite number"));
    return value;
  }
  absl::StatusOr<int> Joint(const YAML::Node& node, const std::string& path) const {
    RS_ASSIGN_OR_RETURN(const std::string name, Text(node, path));
    if (const int joint = FindJoint(robot_, name); joint >= 0) return joint;
    return Error(path, absl::StrCat("is '", name, "', must be one of ", KnownJoints(robot_),
                                    ", the joints of a ", robot_.name));
  }

  absl::Status ReadJoint(const YAML::Node& node, const std::string& path,
                         ScenarioFile& scenario) const {
    RS_RETURN_IF_ERROR(CheckKeys(node, path, {"name", "effects"}));
    RS_ASSIGN_OR_RETURN(const int joint, Joint(node["name"], path + ".name"));
    const YAML::Node effects = node["effects"];
    if (!effects || !effects.IsSequence())
      return Error(path + ".effects", "must be a list; [] for a joint without effects");
    for (size_t i = 0; i < effects.size(); ++i) {
      const std::string place = absl::StrCat(path, ".effects[", i, "]");
      RS_ASSIGN_OR_RETURN(ScenarioEffect effect, ReadEffect(effects[i], place, joint));
      for (const ScenarioEffect& other : scenario.effects) {
        if (other.joint == joint && other.type == effect.type)
          return Error(place, absl::StrCat("'", effect.type, "' stands twice at ",
                                           robot_.joints[joint].name));
        if (other.joint == joint && other.coupled >= 0 && effect.coupled >= 0 &&
            other.coupled != effect.coupled)
          return Error(absl::StrCat(place, ".", kCoupledKey),
                       absl::StrCat("is ", robot_.joints[effect.coupled].name, ", must be ",
                                    robot_.joints[other.coupled].name, " as of '", other.type,
                                    "': a joint is coupled to one other joint"));
      }
      scenario.effects.push_back(std::move(effect));
    }
    return absl::OkStatus();
  }

  absl::StatusOr<ScenarioEffect> ReadEffect(const YAML::Node& node, const std::string& path,
                                            int joint) const {
    ScenarioEffect effect;
    effect.joint = joint;
    if (!node.IsMap()) return Error(path, "must be a map with type and the effect's parameters");
    RS_ASSIGN_OR_RETURN(effect.type, Text(node["type"], path + ".type"));
    const auto info = FindEffect(effect.type);
    if (!info.ok()) return Error(path + ".type", std::string(info.status().message()));
    if ((*info)->of_position) {
      return Error(path + ".type",
                   absl::StrCat("'", effect.type, "' limits the position command of a servo [",
                                (*info)->parameters[0].unit, "], and the motors of a simulated ",
                                robot_.name, " are given torques; leave it out"));
    }
    std::vector<std::string> keys = {"type"};
    for (const EffectParameter& parameter : (*info)->parameters) keys.push_back(parameter.name);
    const bool coupling = (*info)->coupled;
    if (coupling) keys.push_back(kCoupledKey);
    RS_RETURN_IF_ERROR(CheckKeys(node, path, keys));
    for (size_t i = 0; i < (*info)->parameters.size(); ++i) {
      RS_ASSIGN_OR_RETURN(const double value, ReadParameter(node, path, **info, i, joint));
      effect.values.push_back(value);
    }
    if (coupling) {
      const std::string place = absl::StrCat(path, ".", kCoupledKey);
      RS_ASSIGN_OR_RETURN(effect.coupled, Joint(node[kCoupledKey], place));
      if (effect.coupled == joint)
        return Error(place, absl::StrCat("is ", robot_.joints[joint].name,
                                         " itself, must be another joint"));
    }
    return effect;
  }

  absl::StatusOr<double> ReadParameter(const YAML::Node& effect, const std::string& path,
                                       const EffectInfo& info, size_t index, int joint) const {
    const EffectParameter& parameter = info.parameters[index];
    const std::string place = absl::StrCat(path, ".", parameter.name);
    const YAML::Node node = effect[parameter.name];
    if (!node) {
      if (parameter.fixed) return parameter.starts.front();
      return Error(place, absl::StrCat("is missing; '", info.type, "' needs it [", parameter.unit,
                                       "]: ", info.equation));
    }
    RS_ASSIGN_OR_RETURN(const double value, Number(node, place));
    const EffectRange range = RangeInScenario(info, index, robot_, joint);
    if (value >= range.lower && value <= range.upper) return value;
    return Error(place, absl::StrFormat("is %g %s at %s, must be at least %g and at most %g", value,
                                        parameter.unit, robot_.joints[joint].name, range.lower,
                                        range.upper));
  }

  std::string file_;
  const RobotDescription& robot_;
};

}  // namespace

int FindJoint(const RobotDescription& robot, absl::string_view name) {
  for (size_t j = 0; j < robot.joints.size(); ++j) {
    if (name == robot.joints[j].name) return static_cast<int>(j);
  }
  return -1;
}

std::string KnownJoints(const RobotDescription& robot) {
  return absl::StrCat(robot.joints.front().name, " to ", robot.joints.back().name);
}

EffectRange RangeInScenario(const EffectInfo& effect, size_t index, const RobotDescription& robot,
                            int joint) {
  const EffectParameter& parameter = effect.parameters[index];
  const double scale = ArmScale(parameter.scale, robot, joint);
  if (parameter.inverse) return {scale / parameter.upper, scale * kMostLimit};
  // What is no amplitude is divided by.
  const bool amplitude = std::find(effect.amplitudes.begin(), effect.amplitudes.end(),
                                   static_cast<int>(index)) != effect.amplitudes.end();
  // The least wavelength of a search follows from the motion that was recorded; a gear's teeth do
  // not.
  const bool divided = !amplitude && parameter.lower >= 0 && parameter.scale != EffectScale::kOne;
  if (divided) return {scale * kLeastDivisor, scale * parameter.upper};
  return {scale * parameter.lower, scale * parameter.upper};
}

absl::StatusOr<ScenarioFile> ParseScenarioFile(const std::string& file, const std::string& yaml,
                                               const RobotDescription& robot) {
  RS_ASSIGN_OR_RETURN(const YAML::Node root, ReadYamlDocument(file, yaml));
  try {
    return Parser(file, robot).Parse(root);
  } catch (const YAML::Exception& error) {  // a key that is no text
    return absl::InvalidArgumentError(absl::StrCat(file, ": not YAML: ", error.what()));
  }
}

absl::StatusOr<ScenarioFile> ReadScenarioFile(const std::string& file,
                                              const RobotDescription& robot) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  const std::string label = ScenarioLabel(file);
  const std::vector<std::string> known = ScenarioNames();
  if (std::find(known.begin(), known.end(), label) != known.end())
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": a scenario is called by its file's name, and '", label,
                     "' is built in; rename the file"));
  const bool plain = std::all_of(label.begin(), label.end(),
                                 [](unsigned char c) { return std::isalnum(c) || c == '_'; });
  if (label.empty() || !plain)
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": a scenario is called by its file's name, and '", label,
                     "' has other characters than letters, digits and _; rename the file"));
  return ParseScenarioFile(file, text, robot);
}

std::string WriteScenarioFile(const ScenarioFile& scenario, const RobotDescription& robot) {
  YAML::Emitter out;
  out.SetDoublePrecision(12);
  out << YAML::BeginMap;
  if (!scenario.title.empty()) out << YAML::Key << "title" << YAML::Value << scenario.title;
  out << YAML::Key << "base" << YAML::Value << scenario.base;
  out << YAML::Key << "joints" << YAML::Value << YAML::BeginSeq;
  for (int joint = 0; joint < static_cast<int>(robot.joints.size()); ++joint) {
    bool open = false;
    for (const ScenarioEffect& effect : scenario.effects) {
      const auto info = FindEffect(effect.type);
      if (effect.joint != joint || !info.ok()) continue;
      if (!open) {
        out << YAML::BeginMap << YAML::Key << "name" << YAML::Value << robot.joints[joint].name
            << YAML::Key << "effects" << YAML::Value << YAML::BeginSeq;
        open = true;
      }
      out << YAML::Flow << YAML::BeginMap << YAML::Key << "type" << YAML::Value << effect.type;
      for (size_t i = 0; i < effect.values.size(); ++i)
        out << YAML::Key << (*info)->parameters[i].name << YAML::Value << effect.values[i];
      if (effect.coupled >= 0)
        out << YAML::Key << kCoupledKey << YAML::Value << robot.joints[effect.coupled].name;
      out << YAML::EndMap;
    }
    if (open) out << YAML::EndSeq << YAML::EndMap;
  }
  out << YAML::EndSeq << YAML::EndMap;
  return std::string(out.c_str()) + "\n";
}

bool IsScenarioFile(const std::string& scenario) { return absl::EndsWith(scenario, kEnding); }

std::string ScenarioLabel(const std::string& scenario) {
  return IsScenarioFile(scenario) ? std::filesystem::path(scenario).stem().string() : scenario;
}

}  // namespace robostress
