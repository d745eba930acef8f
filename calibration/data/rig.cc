#include "calibration/data/rig.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "calibration/data/rig_entry.h"
#include "common/atomic_file.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/status_macros.h"
#include "common/yaml_document.h"

namespace robostress::calibration {
namespace {

using Entry = RigEntry;

const std::vector<std::pair<std::string, JointInput>> kInputs = {
    {"position_target", JointInput::kPositionTarget},
    {"torque", JointInput::kTorque},
    {"inverse", JointInput::kInverse},
    {"transmission", JointInput::kTransmission}};
const std::vector<std::pair<std::string, Servo::Type>> kServoTypes = {
    {"pd", Servo::Type::kPd}, {"dc_motor", Servo::Type::kDcMotor}};
const std::vector<std::pair<std::string, ServoFeedback>> kFeedbacks = {
    {"link", ServoFeedback::kLink}, {"motor", ServoFeedback::kMotor}};
const std::vector<std::pair<std::string, VelocitySide>> kVelocitySides = {
    {"reading", VelocitySide::kReading}, {"motor", VelocitySide::kMotor}};
const std::vector<std::pair<std::string, LogRole>> kRoles = {
    {"fit", LogRole::kFit}, {"held_out", LogRole::kHeldOut}, {"transfer", LogRole::kTransfer}};
const std::vector<std::pair<std::string, Metric::Type>> kMetrics = {
    {"position_rmse", Metric::Type::kRms},
    {"torque_rmse", Metric::Type::kRms},
    {"position_mae", Metric::Type::kMeanAbsolute},
    {"torque_mae", Metric::Type::kMeanAbsolute}};
const std::vector<std::pair<std::string, Folds>> kFolds = {{"auto", Folds::kAuto},
                                                           {"condition", Folds::kCondition},
                                                           {"log", Folds::kLog},
                                                           {"block", Folds::kBlock}};

template <class E>
std::string NameOf(const std::vector<std::pair<std::string, E>>& choices, E value) {
  for (const auto& [name, choice] : choices) {
    if (choice == value) return name;
  }
  return "";
}

// The bound of a value that the fit keeps too: what is no number of any machine. `path` as in
// RigLog::overrides, without the joint.
absl::Status CheckSign(const Entry& entry, const std::string& path, double value) {
  static const auto& least_zero =
      *new std::set<std::string>{"armature", "damping", "frictionloss", "servo.kd", kKnownMass};
  static const auto& above_zero =
      *new std::set<std::string>{"mass_scale", "torque_gain", "servo.kp", "servo.torque_limit",
                                 "servo.kt",   "servo.R",     "servo.vin"};
  bool open = above_zero.count(path) > 0, bound = open || least_zero.count(path) > 0;
  const size_t dot = path.find('.');
  if (const auto effect = FindEffect(path.substr(0, dot)); effect.ok() && dot != path.npos) {
    if (const auto index = FindParameter(**effect, path.substr(dot + 1)); index.ok()) {
      const EffectParameter& parameter = (*effect)->parameters[static_cast<size_t>(*index)];
      bound = parameter.lower >= 0, open = parameter.inverse;
    }
  }
  if (!bound || value > 0 || (!open && value == 0)) return absl::OkStatus();
  return entry.Error("is ", value, ", must be ", open ? "above 0" : "at least 0");
}

absl::StatusOr<Servo> ReadServo(const Entry& entry) {
  Servo servo;
  RS_RETURN_IF_ERROR(
      entry.CheckKeys({"type", "kp", "kd", "torque_limit", "kt", "R", "vin", "feedback"}));
  RS_RETURN_IF_ERROR(entry["type"].Choice(kServoTypes, servo.type));
  RS_RETURN_IF_ERROR(entry["feedback"].Choice(kFeedbacks, servo.feedback));
  RS_RETURN_IF_ERROR(entry["kp"].Optional(0, servo.kp));
  RS_RETURN_IF_ERROR(entry["kd"].Optional(0, servo.kd));
  RS_RETURN_IF_ERROR(entry["torque_limit"].Optional(0, servo.torque_limit));
  RS_RETURN_IF_ERROR(CheckSign(entry["torque_limit"], "servo.torque_limit", servo.torque_limit));
  RS_RETURN_IF_ERROR(entry["kt"].Optional(0, servo.kt));
  RS_RETURN_IF_ERROR(entry["R"].Optional(0, servo.R));
  RS_RETURN_IF_ERROR(entry["vin"].Optional(0, servo.vin));
  if (servo.kp == 0) return entry["kp"].Error("is missing or 0; a servo without it does not move");
  if (servo.type == Servo::Type::kDcMotor && (servo.kt == 0 || servo.R == 0 || servo.vin == 0))
    return entry.Error("a dc_motor needs kt [Nm/A], R [ohm] and vin [V] above 0");
  return servo;
}

absl::StatusOr<DeclaredEffect> ReadEffect(const Entry& entry) {
  DeclaredEffect effect;
  RS_ASSIGN_OR_RETURN(effect.type, entry["type"].Text());
  const auto info = FindEffect(effect.type);
  if (!info.ok()) return entry["type"].Error(info.status().message());
  std::vector<std::string> keys = {"type", "fit", "partner"};
  for (const EffectParameter& parameter : (*info)->parameters) keys.push_back(parameter.name);
  RS_RETURN_IF_ERROR(entry.CheckKeys(keys));
  for (const EffectParameter& parameter : (*info)->parameters) {
    if (!entry[parameter.name].present()) continue;
    RS_ASSIGN_OR_RETURN(const double value, entry[parameter.name].Number());
    RS_RETURN_IF_ERROR(
        CheckSign(entry[parameter.name], absl::StrCat(effect.type, ".", parameter.name), value));
    effect.parameters[parameter.name] = value;
  }
  if (entry["partner"].present()) {
    RS_ASSIGN_OR_RETURN(effect.partner, entry["partner"].Text());
  }
  RS_ASSIGN_OR_RETURN(effect.fit, entry["fit"].Texts());
  for (const std::string& name : effect.fit) {
    if (const auto index = FindParameter(**info, name); !index.ok())
      return entry["fit"].Error(index.status().message());
  }
  return effect;
}

absl::StatusOr<RigJoint> ReadJoint(const Entry& entry) {
  RigJoint joint;
  RS_RETURN_IF_ERROR(entry.CheckKeys(
      {"name", "input", "velocity", "servo", "enable", "parameters", "fit", "effects"}));
  RS_ASSIGN_OR_RETURN(joint.name, entry["name"].Text());
  if (!entry["input"].present()) return entry["input"].Error("is missing");
  RS_RETURN_IF_ERROR(entry["input"].Choice(kInputs, joint.input));
  RS_RETURN_IF_ERROR(entry["velocity"].Choice(kVelocitySides, joint.velocity));
  if (entry["servo"].present()) {
    RS_ASSIGN_OR_RETURN(joint.servo, ReadServo(entry["servo"]));
  } else if (joint.input == JointInput::kPositionTarget) {
    return entry["servo"].Error("is missing; input position_target drives a servo");
  }
  const auto& known = ModelParameterNames();
  const Entry parameters = entry["parameters"];
  if (parameters.present()) {
    RS_RETURN_IF_ERROR(parameters.CheckKeys(known));
    for (const auto& pair : parameters.node()) {
      const std::string name = pair.first.Scalar();
      RS_ASSIGN_OR_RETURN(const double value, parameters[name].Number());
      RS_RETURN_IF_ERROR(CheckSign(parameters[name], name, value));
      joint.parameters[name] = value;
    }
  }
  if (entry["enable"].present()) {
    RS_ASSIGN_OR_RETURN(joint.enable, entry["enable"].Text());
  }
  RS_ASSIGN_OR_RETURN(joint.fit, entry["fit"].Texts());
  for (const std::string& name : joint.fit) {
    if (std::find(known.begin(), known.end(), name) == known.end())
      return entry["fit"].Error("unknown parameter '", name,
                                "'; known: ", absl::StrJoin(known, ", "));
  }
  const Entry effects = entry["effects"];
  if (effects.present() && !effects.node().IsSequence())
    return effects.Error("must be a list of effects");
  for (size_t i = 0; effects.present() && i < effects.node().size(); ++i) {
    RS_ASSIGN_OR_RETURN(DeclaredEffect effect, ReadEffect(effects[i]));
    joint.effects.push_back(std::move(effect));
  }
  return joint;
}

// Replaces every ${NAME} by that environment variable.
absl::StatusOr<std::string> Expand(const Entry& entry, std::string text) {
  for (size_t begin = text.find("${"); begin != std::string::npos; begin = text.find("${")) {
    const size_t end = text.find('}', begin);
    if (end == std::string::npos) return entry.Error("is '", text, "': '${' without '}'");
    const std::string name = text.substr(begin + 2, end - begin - 2);
    const char* value = std::getenv(name.c_str());
    if (value == nullptr || *value == 0)
      return entry.Error("is '", text, "', and the environment variable ", name,
                         " is not set; set it to the folder of the recordings");
    text.replace(begin, end + 1 - begin, value);
  }
  return text;
}

// Whose override `key` is; nullptr: no joint's.
const RigJoint* JointOf(const std::vector<RigJoint>& joints, const std::string& key) {
  const auto found = std::find_if(joints.begin(), joints.end(), [&](const RigJoint& joint) {
    return absl::StartsWith(key, joint.name + ".");
  });
  return found == joints.end() ? nullptr : &*found;
}

absl::StatusOr<RigLog> ReadLogEntry(const Entry& entry, const std::filesystem::path& folder,
                                    const std::vector<RigJoint>& joints) {
  RigLog log;
  RS_RETURN_IF_ERROR(entry.CheckKeys({"file", "role", "condition", "overrides"}));
  RS_ASSIGN_OR_RETURN(std::string file, entry["file"].Text());
  RS_ASSIGN_OR_RETURN(file, Expand(entry["file"], file));
  log.file = (folder / file).string();
  RS_RETURN_IF_ERROR(entry["role"].Choice(kRoles, log.role));
  if (entry["condition"].present()) {
    RS_ASSIGN_OR_RETURN(log.condition, entry["condition"].Text());
  }
  const Entry overrides = entry["overrides"];
  if (!overrides.present()) return log;
  if (!overrides.node().IsMap()) return overrides.Error("must be a map of numbers");
  RS_RETURN_IF_ERROR(overrides.CheckOnce());
  for (const auto& pair : overrides.node()) {
    const std::string key = pair.first.Scalar();
    const RigJoint* joint = JointOf(joints, key);
    if (joint == nullptr) return overrides.Error("'", key, "' begins with no joint of this rig");
    RS_ASSIGN_OR_RETURN(log.overrides[key], overrides[key].Number());
    RS_RETURN_IF_ERROR(
        CheckSign(overrides[key], key.substr(joint->name.size() + 1), log.overrides[key]));
  }
  return log;
}

bool HaveSameContent(const std::string& a, const std::string& b) {
  std::error_code error;
  const auto size = std::filesystem::file_size(a, error);
  if (error || size != std::filesystem::file_size(b, error) || error) return false;
  std::ifstream first(a, std::ios::binary), second(b, std::ios::binary);
  return std::equal(std::istreambuf_iterator<char>(first), std::istreambuf_iterator<char>(),
                    std::istreambuf_iterator<char>(second));
}

// Whether two names are of one file, or the file of one is a copy of the other: what was fitted
// would be held out.
bool AreOneLog(const std::string& a, const std::string& b) {
  std::error_code error;
  const auto first = std::filesystem::weakly_canonical(a, error);
  if (!error && first == std::filesystem::weakly_canonical(b, error) && !error) return true;
  return HaveSameContent(a, b);
}

absl::Status CheckWhole(const Entry& root, const Rig& rig, RigLogs logs) {
  std::set<std::string> names;
  for (const RigJoint& joint : rig.joints) {
    if (!names.insert(joint.name).second)
      return root["joints"].Error("joint '", joint.name, "' is listed twice");
  }
  bool any_fit = false;
  for (size_t i = 0; i < rig.logs.size(); ++i) {
    for (size_t k = 0; k < i; ++k)
      if (AreOneLog(rig.logs[i].file, rig.logs[k].file))
        return root["logs"][i].Error("file '", rig.logs[i].file, "' is or copies '",
                                     rig.logs[k].file, "' of logs[", k, "]; leave one");
    any_fit |= rig.logs[i].role == LogRole::kFit;
  }
  if (!any_fit && logs == RigLogs::kNeeded)
    return root["logs"].Error("no log has role fit; nothing could be fitted");
  return absl::OkStatus();
}

// A metric is of what the input compares.
absl::Status CheckMetric(const Entry& type, const std::vector<RigJoint>& joints) {
  const bool torque = absl::StartsWith(type.node().Scalar(), "torque_");
  for (const RigJoint& joint : joints) {
    if (torque != (joint.input == JointInput::kInverse))
      return type.Error(
          "is '", type.node().Scalar(), "', and input ", NameOf(kInputs, joint.input),
          " of joint '", joint.name, "' compares ",
          torque ? "positions: position_rmse, position_mae" : "torques: torque_rmse, torque_mae");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::array<double, 3>> ReadGravity(const Entry& entry) {
  constexpr double kMost = 100;  // [m/s^2]
  if (!entry.node().IsSequence() || entry.node().size() != 3)
    return entry.Error(
        "must be three numbers in the frame of the model's base, [0, 0, -9.81] of "
        "an upright one");
  std::array<double, 3> gravity;
  for (size_t i = 0; i < 3; ++i) {
    RS_ASSIGN_OR_RETURN(gravity[i], entry[i].Number());
    if (std::abs(gravity[i]) > kMost)
      return entry[i].Error("is ", gravity[i], " m/s^2, must be within ", kMost);
  }
  return gravity;
}

absl::StatusOr<Rig> ReadRoot(const Entry& root, const std::string& file, RigLogs needed) {
  Rig rig;
  rig.file = file;
  const std::filesystem::path folder = std::filesystem::path(file).parent_path();
  RS_RETURN_IF_ERROR(
      root.CheckKeys({"name", "model", "gravity", "rate_hz", "joints", "logs", "metric", "folds"}));
  RS_ASSIGN_OR_RETURN(rig.name, root["name"].Text());
  RS_ASSIGN_OR_RETURN(const std::string model, root["model"].Text());
  rig.model = (folder / model).string();
  if (root["gravity"].present()) {
    RS_ASSIGN_OR_RETURN(rig.gravity, ReadGravity(root["gravity"]));
  }
  RS_ASSIGN_OR_RETURN(rig.rate_hz, root["rate_hz"].Number());
  if (rig.rate_hz < 1 || rig.rate_hz > 1e5)
    return root["rate_hz"].Error(
        "is ", rig.rate_hz, ", must be 1 to 100000 rows per second",
        rig.rate_hz >= 1e-3 && rig.rate_hz < 1
            ? "; of a clock in milliseconds multiply it by 1000, and t by 0.001"
            : "");
  const Entry joints = root["joints"], logs = root["logs"];
  if (!joints.present() || !joints.node().IsSequence() || joints.node().size() == 0)
    return joints.Error("must be a list with at least one joint");
  for (size_t i = 0; i < joints.node().size(); ++i) {
    RS_ASSIGN_OR_RETURN(RigJoint joint, ReadJoint(joints[i]));
    rig.joints.push_back(std::move(joint));
  }
  const bool listed = logs.present() && logs.node().IsSequence();
  if (needed == RigLogs::kNeeded ? !listed || logs.node().size() == 0 : logs.present() && !listed)
    return logs.Error(needed == RigLogs::kNeeded ? "must be a list with at least one log"
                                                 : "must be a list");
  for (size_t i = 0; listed && i < logs.node().size(); ++i) {
    RS_ASSIGN_OR_RETURN(RigLog log, ReadLogEntry(logs[i], folder, rig.joints));
    rig.logs.push_back(std::move(log));
  }
  const Entry metric = root["metric"];
  if (metric.present()) {
    RS_RETURN_IF_ERROR(metric.CheckKeys({"type", "window_s", "unit"}));
    RS_RETURN_IF_ERROR(metric["type"].Choice(kMetrics, rig.metric.type));
    if (metric["type"].present()) RS_RETURN_IF_ERROR(CheckMetric(metric["type"], rig.joints));
    RS_RETURN_IF_ERROR(metric["window_s"].Optional(0, rig.metric.window_s));
    if (metric["unit"].present()) {
      RS_ASSIGN_OR_RETURN(rig.metric.unit, metric["unit"].Text());
    }
  }
  RS_RETURN_IF_ERROR(root["folds"].Choice(kFolds, rig.folds));
  RS_RETURN_IF_ERROR(CheckWhole(root, rig, needed));
  return rig;
}

}  // namespace

const std::vector<std::string>& ModelParameterNames() {
  static const auto& names = *new std::vector<std::string>{
      "armature",      "mass_scale",      "damping",     "frictionloss",  "servo.kp", "servo.kd",
      "torque_offset", "position_offset", "torque_gain", "command_shift", "force_lag"};
  return names;
}

absl::StatusOr<Rig> ReadRig(const std::string& file, RigLogs logs) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  RS_ASSIGN_OR_RETURN(const YAML::Node root, ReadYamlDocument(file, text));
  try {
    return ReadRoot(Entry(root, file + ":"), file, logs);
  } catch (const YAML::Exception& error) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": not YAML: ", error.what()));
  }
}

std::string RelativePath(const std::string& path, const std::string& folder) {
  namespace fs = std::filesystem;
  const fs::path from = fs::absolute(folder).lexically_normal();
  const fs::path to = fs::absolute(path).lexically_normal();
  const fs::path plain = to.lexically_relative(from);
  std::error_code error;
  const fs::path real = fs::weakly_canonical(from, error);
  if (error || real == from || plain.begin() == plain.end() || *plain.begin() != "..")
    return plain.string();
  const fs::path real_parent = fs::weakly_canonical(to.parent_path(), error);
  return error ? plain.string() : (real_parent / to.filename()).lexically_relative(real).string();
}

std::string WriteRig(const Rig& rig) {
  const std::filesystem::path folder = std::filesystem::path(rig.file).parent_path();
  const auto relative = [&](const std::string& path) { return RelativePath(path, folder); };
  YAML::Emitter out;
  out.SetDoublePrecision(12);
  out << YAML::BeginMap;
  out << YAML::Key << "name" << YAML::Value << rig.name;
  out << YAML::Key << "model" << YAML::Value << relative(rig.model);
  if (rig.gravity)
    out << YAML::Key << "gravity" << YAML::Value << YAML::Flow
        << std::vector<double>(rig.gravity->begin(), rig.gravity->end());
  out << YAML::Key << "rate_hz" << YAML::Value << rig.rate_hz;
  out << YAML::Key << "joints" << YAML::Value << YAML::BeginSeq;
  for (const RigJoint& joint : rig.joints) {
    out << YAML::BeginMap << YAML::Key << "name" << YAML::Value << joint.name;
    out << YAML::Key << "input" << YAML::Value << NameOf(kInputs, joint.input);
    if (joint.velocity != VelocitySide::kReading)
      out << YAML::Key << "velocity" << YAML::Value << NameOf(kVelocitySides, joint.velocity);
    if (joint.servo.kp > 0) {
      const Servo& s = joint.servo;
      out << YAML::Key << "servo" << YAML::Value << YAML::Flow << YAML::BeginMap;
      out << YAML::Key << "type" << YAML::Value << NameOf(kServoTypes, s.type);
      out << YAML::Key << "kp" << YAML::Value << s.kp << YAML::Key << "kd" << YAML::Value << s.kd;
      if (std::isfinite(s.torque_limit))
        out << YAML::Key << "torque_limit" << YAML::Value << s.torque_limit;
      if (s.type == Servo::Type::kDcMotor)
        out << YAML::Key << "kt" << YAML::Value << s.kt << YAML::Key << "R" << YAML::Value << s.R
            << YAML::Key << "vin" << YAML::Value << s.vin;
      out << YAML::Key << "feedback" << YAML::Value << NameOf(kFeedbacks, s.feedback);
      out << YAML::EndMap;
    }
    if (!joint.parameters.empty())
      out << YAML::Key << "parameters" << YAML::Value << YAML::Flow << joint.parameters;
    if (!joint.enable.empty()) out << YAML::Key << "enable" << YAML::Value << joint.enable;
    if (!joint.fit.empty()) out << YAML::Key << "fit" << YAML::Value << YAML::Flow << joint.fit;
    out << YAML::Key << "effects" << YAML::Value << YAML::BeginSeq;
    for (const DeclaredEffect& effect : joint.effects) {
      out << YAML::Flow << YAML::BeginMap << YAML::Key << "type" << YAML::Value << effect.type;
      for (const auto& [name, value] : effect.parameters)
        out << YAML::Key << name << YAML::Value << value;
      if (!effect.partner.empty()) out << YAML::Key << "partner" << YAML::Value << effect.partner;
      if (!effect.fit.empty()) out << YAML::Key << "fit" << YAML::Value << effect.fit;
      out << YAML::EndMap;
    }
    out << YAML::EndSeq << YAML::EndMap;
  }
  out << YAML::EndSeq;
  out << YAML::Key << "logs" << YAML::Value << YAML::BeginSeq;
  for (const RigLog& log : rig.logs) {
    out << YAML::Flow << YAML::BeginMap;
    out << YAML::Key << "file" << YAML::Value << relative(log.file);
    out << YAML::Key << "role" << YAML::Value << NameOf(kRoles, log.role);
    if (!log.condition.empty()) out << YAML::Key << "condition" << YAML::Value << log.condition;
    if (!log.overrides.empty()) out << YAML::Key << "overrides" << YAML::Value << log.overrides;
    out << YAML::EndMap;
  }
  out << YAML::EndSeq;
  out << YAML::Key << "metric" << YAML::Value << YAML::Flow << YAML::BeginMap;
  if (rig.metric.type == Metric::Type::kMeanAbsolute)
    out << YAML::Key << "type" << YAML::Value
        << (rig.joints.front().input == JointInput::kInverse ? "torque_mae" : "position_mae");
  out << YAML::Key << "window_s" << YAML::Value << rig.metric.window_s;
  if (!rig.metric.unit.empty()) out << YAML::Key << "unit" << YAML::Value << rig.metric.unit;
  out << YAML::EndMap;
  out << YAML::Key << "folds" << YAML::Value << NameOf(kFolds, rig.folds);
  out << YAML::EndMap;
  return std::string(out.c_str()) + "\n";
}

absl::StatusOr<RigLog> ParseRigLog(const std::string& text, const Rig& rig) {
  const std::vector<std::string> parts = absl::StrSplit(text, ',');
  RigLog log;
  log.file = parts[0];
  for (const RigLog& other : rig.logs) {
    if (AreOneLog(other.file, log.file))
      return absl::InvalidArgumentError(absl::StrCat("--add-log ", text, ": ", rig.file,
                                                     " lists this file already, as ", other.file));
  }
  for (size_t i = 1; i < parts.size(); ++i) {
    const std::pair<std::string, std::string> pair =
        absl::StrSplit(parts[i], absl::MaxSplits('=', 1));
    double value = 0;
    const RigJoint* joint = JointOf(rig.joints, pair.first);
    if (joint == nullptr || !absl::SimpleAtod(pair.second, &value) || !std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--add-log ", text, ": '", parts[i], "' must be JOINT.PARAMETER=NUMBER with a joint of ",
          rig.file, ", as elbow.known_mass=0.3"));
    }
    RS_RETURN_IF_ERROR(CheckSign(Entry({}, absl::StrCat("--add-log ", text, ": ", pair.first)),
                                 pair.first.substr(joint->name.size() + 1), value));
    log.overrides[pair.first] = value;
  }
  return log;
}

}  // namespace robostress::calibration
