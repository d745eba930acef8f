#include "robot_client/bridge/robot_file.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "robot_client/bridge/chain_model.h"

namespace robostress::bridge {
namespace {

struct FileOptions {
  std::string name;
  double rate_hz = 30;
  std::vector<double> home;
  ExpectedDriver driver;
  bool simulated = false;
  ModelOptions model;
  WorkspaceOptions workspace;

  template <class V>
  void Visit(V& v) {
    v.Field("name", name, "of the robot, for records");
    v.Field("rate_hz", rate_hz, "of the control loop");
    v.Field("home", home, "a number per joint [rad], then the gripper [m]; empty: none");
    v.Section("driver", driver, "what the driver must be able to do");
    v.Field("simulated", simulated, "no arm that can hurt anybody: --automatic is allowed");
    v.Section("model", model, "of its mechanics: table, box and torques are watched by it");
    v.Section("workspace", workspace, "where it may be, as control.workspace; with a model");
  }
};

// One file's complaints, with its name in front.
class Checker {
 public:
  explicit Checker(std::string file) : file_(std::move(file)) {}

  template <class... Parts>
  absl::Status Wrong(const Parts&... parts) const {
    return absl::InvalidArgumentError(absl::StrCat(file_, ": ", parts...));
  }
  absl::Status Within(const std::string& field, double value, double least, double most,
                      const char* unit) const {
    if (value >= least && value <= most) return absl::OkStatus();
    return Wrong(field, " is ", value, ", must be ", least, " to ", most, " ", unit);
  }

 private:
  const std::string file_;
};

absl::StatusOr<Conversion> ConversionOf(const Checker& checker, const std::string& where,
                                        const AxisOptions& axis, bool joint) {
  const char* unit = joint ? "rad" : "m";
  if (axis.unit == AxisUnit::kRange) {
    for (const auto& [key, values] :
         {std::pair("driver_range", &axis.driver_range), std::pair("range", &axis.range)}) {
      if (values->size() != 2 || !(std::abs((*values)[0] - (*values)[1]) > 1e-9) ||
          !(std::abs((*values)[0]) <= kMostValue && std::abs((*values)[1]) <= kMostValue))
        return checker.Wrong(where, ".", key, " is [", absl::StrJoin(*values, ", "),
                             "], must be two different numbers: unit is range");
    }
    if (axis.sign != 1 || axis.zero != 0)
      return checker.Wrong(where,
                           " has unit range, which says sign and zero by itself: leave sign (",
                           axis.sign, ") and zero (", axis.zero, ") out");
    const double scale =
        (axis.range[1] - axis.range[0]) / (axis.driver_range[1] - axis.driver_range[0]);
    return Conversion{scale, axis.range[0] - scale * axis.driver_range[0]};
  }
  if (!axis.driver_range.empty() || !axis.range.empty())
    return checker.Wrong(where, " has driver_range or range, which need unit: range");
  if ((axis.unit == AxisUnit::kMetres) == joint)
    return checker.Wrong(where, ".unit is ", joint ? "metres" : "an angle's", ", must be ",
                         joint ? "radians, degrees or range" : "metres or range");
  if (axis.sign != 1 && axis.sign != -1)
    return checker.Wrong(where, ".sign is ", axis.sign, ", must be 1 or -1");
  RS_RETURN_IF_ERROR(checker.Within(where + ".zero", axis.zero, -10, 10, unit));
  return Conversion{axis.sign * (axis.unit == AxisUnit::kDegrees ? M_PI / 180 : 1), axis.zero};
}

absl::Status CheckAxis(const Checker& checker, const std::string& where, const AxisOptions& axis,
                       bool joint) {
  if (axis.name.empty() || axis.name.size() > 64)
    return checker.Wrong(where, ".name is '", axis.name,
                         "', must be what the driver calls the axis, at most 64 characters");
  const double most = joint ? 4 * M_PI : 2;
  const char* unit = joint ? "rad" : "m";
  RS_RETURN_IF_ERROR(checker.Within(where + ".lower", axis.lower, -most, most, unit));
  RS_RETURN_IF_ERROR(checker.Within(where + ".upper", axis.upper, -most, most, unit));
  if (!(axis.lower < axis.upper))
    return checker.Wrong(where, ".lower is ", axis.lower, " and upper ", axis.upper, " ", unit,
                         "; the first must be below the second");
  RS_RETURN_IF_ERROR(
      checker.Within(where + ".velocity", axis.velocity, 0.001, 10, joint ? "rad/s" : "m/s"));
  return checker.Within(where + ".acceleration", axis.acceleration, 0.01, 200,
                        joint ? "rad/s^2" : "m/s^2");
}

absl::StatusOr<AxisOptions> ReadAxis(const std::string& file, const std::string& where,
                                     const YAML::Node& node) {
  if (!node.IsMap())
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", where, " must be a section with name, unit, lower, upper ..."));
  ConfigReader reader(absl::StrCat(file, ": ", where), node);
  AxisOptions axis;
  axis.Visit(reader);
  RS_RETURN_IF_ERROR(reader.Finish());
  return axis;
}

absl::Status CheckModel(const Checker& checker, const BridgeRobot& robot, bool has_workspace) {
  const size_t joints = robot.joints.size();
  for (size_t j = 0; j < joints; ++j) {
    const std::string where = absl::StrCat("joints[", j, "].press");
    const double press = robot.joints[j].press;
    if (!robot.watches_torque() && press != 0)
      return checker.Wrong(where, " is ", press,
                           " Nm, and torques are watched with model and driver.measures_effort: "
                           "true only; give them, or leave press out");
    if (robot.watches_torque()) RS_RETURN_IF_ERROR(checker.Within(where, press, 0.01, 100, "Nm"));
  }
  if (robot.gripper && robot.gripper->press != 0)
    return checker.Wrong("gripper.press is ", robot.gripper->press,
                         ", and a gripper may press; leave it out");
  if (!robot.model) {
    if (!has_workspace) return absl::OkStatus();
    return checker.Wrong("workspace needs model: without one nobody knows where the arm is");
  }
  const ModelOptions& model = *robot.model;
  if (model.file.empty() || model.tool.empty())
    return checker.Wrong("model.", model.file.empty() ? "file" : "tool",
                         " is empty; name the URDF, and the link of it that is the tool's point");
  if (!model.joints.empty() && model.joints.size() != joints)
    return checker.Wrong("model.joints has ", model.joints.size(), " names, must have ", joints,
                         ": one per joint, or none");
  RS_RETURN_IF_ERROR(checker.Within("model.radius", model.radius, 0, 0.5, "m"));
  for (const std::string& links : model.ignore) {
    if (const absl::Status pair = ParseLinkPair(links, static_cast<int>(joints)).status();
        !pair.ok())
      return checker.Wrong("model.ignore has ", pair.message());
  }
  if (!has_workspace)
    return checker.Wrong(
        "workspace is missing: with a model say where the arm may be (table_z, lower, upper [m] in "
        "its base frame)");
  const absl::Status workspace = CheckWorkspace(robot.workspace, "workspace");
  return workspace.ok() ? workspace : checker.Wrong(workspace.message());
}

absl::Status Complete(const Checker& checker, BridgeRobot& robot) {
  if (robot.joints.empty() || robot.joints.size() > kMostJoints) {
    return checker.Wrong("joints has ", robot.joints.size(), " entries, must have 1 to ",
                         kMostJoints,
                         robot.joints.size() > kMostJoints
                             ? ": leave those out that the driver can keep still by itself"
                             : ": a section per joint, from the base on");
  }
  robot.limits.axes = {static_cast<int>(robot.joints.size()), robot.gripper.has_value()};
  const ArmAxes& axes = robot.limits.axes;
  std::set<std::string> names;
  for (int i = 0; i < axes.count(); ++i) {
    const bool joint = i < axes.joints;
    const AxisOptions& axis = joint ? robot.joints[i] : *robot.gripper;
    const std::string where = joint ? absl::StrCat("joints[", i, "]") : "gripper";
    RS_RETURN_IF_ERROR(CheckAxis(checker, where, axis, joint));
    RS_ASSIGN_OR_RETURN(const Conversion conversion, ConversionOf(checker, where, axis, joint));
    robot.conversions.push_back(conversion);
    if (!names.insert(axis.name).second)
      return checker.Wrong(where, ".name is '", axis.name,
                           "', which another axis has: names must differ");
    robot.limits.lower[i] = axis.lower;
    robot.limits.upper[i] = axis.upper;
    robot.limits.max_velocity[i] = axis.velocity;
    robot.limits.max_acceleration[i] = axis.acceleration;
  }
  if (robot.name.empty()) return checker.Wrong("name is empty; name the robot");
  RS_RETURN_IF_ERROR(checker.Within("rate_hz", robot.rate_hz, 5, 200, "Hz"));
  RS_RETURN_IF_ERROR(checker.Within("driver.watchdog_s", robot.driver.watchdog_s, 0.02, 2, "s"));
  if (robot.home.empty()) return absl::OkStatus();
  if (static_cast<int>(robot.home.size()) != axes.count())
    return checker.Wrong("home has ", robot.home.size(), " numbers, must have ", axes.count(),
                         ": one per joint [rad]", axes.gripper ? ", then the gripper [m]" : "");
  for (int i = 0; i < axes.count(); ++i) {
    RS_RETURN_IF_ERROR(checker.Within(absl::StrCat("home[", i, "]"), robot.home[i],
                                      robot.limits.lower[i], robot.limits.upper[i],
                                      "(lower and upper of that axis)"));
  }
  return absl::OkStatus();
}

}  // namespace

std::vector<std::string> BridgeRobot::names() const {
  std::vector<std::string> names;
  for (const AxisOptions& joint : joints) names.push_back(joint.name);
  if (gripper) names.push_back(gripper->name);
  return names;
}

absl::StatusOr<BridgeRobot> LoadBridgeRobot(const std::string& file) {
  constexpr uint64_t kMostBytes = 1 << 16;
  constexpr uint64_t kMostModelBytes = 16 << 20;
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(file, kMostBytes));
  RS_ASSIGN_OR_RETURN(BridgeRobot robot, ParseBridgeRobot(file, text));
  if (!robot.model) return robot;
  const std::filesystem::path folder = std::filesystem::path(file).parent_path();
  ModelOptions model = *robot.model;
  for (std::string& package : model.packages) package = (folder / package).string();
  std::vector<std::string> joints = model.joints;
  if (joints.empty()) {
    for (const AxisOptions& joint : robot.joints) joints.push_back(joint.name);
  }
  const std::string path = (folder / model.file).lexically_normal().string();
  RS_ASSIGN_OR_RETURN(const std::string urdf, ReadFileUpTo(path, kMostModelBytes));
  RS_ASSIGN_OR_RETURN(robot.chain, ReadArmChain(path, urdf, joints, robot.limits, model));
  return robot;
}

absl::Status ChooseWatched(const WorkspaceOptions& workspace, const std::vector<double>& home,
                           BridgeRobot& robot) {
  if (!robot.chain) return absl::OkStatus();
  std::vector<LinkPair> ignored;
  for (const std::string& links : robot.model->ignore) {
    RS_ASSIGN_OR_RETURN(const LinkPair pair, ParseLinkPair(links, robot.limits.axes.joints));
    ignored.push_back(pair);
  }
  ChooseLinkPairs(robot.limits, home, workspace.margin, ignored, &*robot.chain);
  return LeaveLowPartsOut(robot.limits, workspace, &*robot.chain);
}

absl::StatusOr<BridgeRobot> ParseBridgeRobot(const std::string& file, const std::string& yaml) {
  RS_ASSIGN_OR_RETURN(YAML::Node root, config_internal::ParseYaml(file, yaml));
  const Checker checker(file);
  BridgeRobot robot;
  const YAML::Node joints = root["joints"], gripper = root["gripper"];
  if (!joints || !joints.IsSequence())
    return checker.Wrong("joints is missing, or no list: a section per joint, from the base on");
  for (size_t i = 0; i < joints.size() && i < 64; ++i) {
    RS_ASSIGN_OR_RETURN(AxisOptions axis,
                        ReadAxis(file, absl::StrCat("joints[", i, "]"), joints[i]));
    robot.joints.push_back(std::move(axis));
  }
  if (gripper) {
    RS_ASSIGN_OR_RETURN(robot.gripper, ReadAxis(file, "gripper", gripper));
  }
  YAML::Node rest(YAML::NodeType::Map);
  std::set<std::string> keys;
  for (const auto& entry : root) {
    if (!entry.first.IsScalar()) return checker.Wrong("a key is no word");
    const std::string key = entry.first.Scalar();
    if (!keys.insert(key).second) return checker.Wrong(key, " stands twice");
    if (key != "joints" && key != "gripper") rest[key] = entry.second;
  }
  ConfigReader reader(file, rest);
  FileOptions options;
  options.Visit(reader);
  RS_RETURN_IF_ERROR(reader.Finish());
  robot.name = options.name;
  robot.rate_hz = options.rate_hz;
  robot.home = options.home;
  robot.driver = options.driver;
  robot.simulated = options.simulated;
  if (root["model"]) robot.model = options.model;
  robot.workspace = options.workspace;
  RS_RETURN_IF_ERROR(Complete(checker, robot));
  RS_RETURN_IF_ERROR(CheckModel(checker, robot, root["workspace"].IsDefined()));
  return robot;
}

std::string Missing(const ExpectedDriver& expected, const Welcome& welcome) {
  std::vector<std::string> missing;
  const auto need = [&](bool wanted, bool there, const char* name) {
    if (wanted && !there) missing.emplace_back(name);
  };
  need(expected.stop, welcome.stop, "stop");
  need(expected.hold, welcome.hold, "hold");
  need(expected.torque_off, welcome.torque_off, "torque_off");
  need(expected.measures_velocity, welcome.measures_velocity, "measures_velocity");
  need(expected.measures_effort, welcome.measures_effort, "measures_effort");
  const bool watched = welcome.on_silence != OnSilence::kNothing && welcome.watchdog_s > 0;
  need(expected.on_silence, watched, "on_silence (it does nothing when this client is silent)");
  if (expected.on_silence && watched && welcome.watchdog_s > expected.watchdog_s)
    missing.push_back(absl::StrCat("watchdog_s (it waits ", welcome.watchdog_s, " s, at most ",
                                   expected.watchdog_s, " s are allowed)"));
  return absl::StrJoin(missing, ", ");
}

}  // namespace robostress::bridge
