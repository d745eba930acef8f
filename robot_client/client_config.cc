#include "robot_client/client_config.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/status_macros.h"
#include "robot_client/bridge/bridge_arm.h"
#include "robot_client/bridge/chain_model.h"
#include "robot_client/cameras/faulty_source.h"
#include "robot_client/cameras/file_source.h"
#include "robot_client/cameras/mapped_frames.h"
#include "robot_client/cameras/synthetic_source.h"
#include "robot_client/cameras/v4l2_source.h"
#include "robot_client/can/bus_address.h"
#include "robot_client/piper/piper_arm.h"
#include "robot_client/piper/piper_model.h"
#include "robot_client/rehearsal_arm.h"

namespace robostress {
namespace {

absl::StatusOr<std::unique_ptr<FrameSource>> MakeSource(const std::string& name,
                                                        absl::string_view source, Clock* clock) {
  if (source == "synthetic") {
    SyntheticSourceOptions options;
    options.name = name;
    return std::unique_ptr<FrameSource>(std::make_unique<SyntheticSource>(options, clock));
  }
  if (absl::ConsumePrefix(&source, "files:")) {
    FileSourceOptions options;
    options.name = name;
    options.directory = std::string(source);
    return std::unique_ptr<FrameSource>(std::make_unique<FileSource>(options, clock));
  }
  if (absl::ConsumePrefix(&source, "mapped:"))
    return std::unique_ptr<FrameSource>(
        std::make_unique<MappedSource>(name, std::string(source), clock));
  if (absl::ConsumePrefix(&source, "v4l2:")) {
    V4l2SourceOptions options;
    options.name = name;
    const std::vector<std::string> parts = absl::StrSplit(source, absl::MaxSplits('@', 1));
    options.device = parts[0];
    if (parts.size() == 2) {
      const std::vector<std::string> size = absl::StrSplit(parts[1], 'x');
      if (size.size() != 2 || !absl::SimpleAtoi(size[0], &options.width) ||
          !absl::SimpleAtoi(size[1], &options.height)) {
        return absl::InvalidArgumentError(
            absl::StrCat("camera '", name, "': size '", parts[1], "' must be WIDTHxHEIGHT"));
      }
    }
    return std::unique_ptr<FrameSource>(
        std::make_unique<V4l2Source>(options, MakeV4l2System(), clock));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("camera '", name, "' has source '", source,
                   "'; use v4l2:/dev/v4l/by-id/..., files:DIR, mapped:FILE or synthetic"));
}

}  // namespace

bool IsBridge(const ClientConfig& config) { return absl::StartsWith(config.bus, "bridge:"); }

absl::StatusOr<bool> IsReal(const ClientConfig& config) {
  if (!IsBridge(config))
    return absl::StartsWith(config.bus, "can:") && !absl::StartsWith(config.bus, "can:vcan");
  RS_ASSIGN_OR_RETURN(const bridge::BridgeRobot robot, bridge::LoadBridgeRobot(config.robot));
  return !robot.simulated;
}

absl::StatusOr<ArmAxes> AxesOf(const ClientConfig& config) {
  if (!IsBridge(config)) return PiperLimits().axes;
  RS_ASSIGN_OR_RETURN(const bridge::BridgeRobot robot, bridge::LoadBridgeRobot(config.robot));
  return robot.limits.axes;
}

absl::StatusOr<std::vector<std::string>> RigNamesOf(const ClientConfig& config) {
  std::vector<std::string> names;
  if (!IsBridge(config)) {
    for (int j = 1; j <= PiperLimits().axes.joints; ++j)
      names.push_back(absl::StrCat("piper_joint", j));
    return names;
  }
  RS_ASSIGN_OR_RETURN(const bridge::BridgeRobot robot, bridge::LoadBridgeRobot(config.robot));
  if (robot.model && !robot.model->joints.empty()) return robot.model->joints;
  for (const bridge::AxisOptions& joint : robot.joints) names.push_back(joint.name);
  return names;
}

absl::Status TakeRobotFile(ClientConfig& config) {
  if (!IsBridge(config)) {
    if (config.robot.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("robot is ", config.robot, " and bus ", config.bus,
                     ": a robot file describes an arm behind a driver; give --arm "
                     "bridge:unix:SOCKET, or leave --robot out"));
  }
  if (config.robot.empty())
    return absl::InvalidArgumentError(
        absl::StrCat("bus is ", config.bus,
                     " and no robot file says what is there; give --robot FILE, for one "
                     "robot_client/bridge/so101.yaml"));
  RS_ASSIGN_OR_RETURN(const bridge::BridgeRobot robot, bridge::LoadBridgeRobot(config.robot));
  config.control.rate_hz = robot.rate_hz;
  config.home = robot.home;
  PressOptions& press = config.control.press;
  FitDefaults(robot.limits.axes.joints, press);
  if (robot.model) config.control.workspace = robot.workspace;
  if (robot.watches_torque()) {
    for (size_t j = 0; j < robot.joints.size(); ++j) press.excess[j] = robot.joints[j].press;
  }
  return absl::OkStatus();
}

absl::Status CheckConfig(const ClientConfig& c) {
  const auto invalid = [](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  RS_RETURN_IF_ERROR(CheckGuards(c.control.watchdogs, c.control.press, c.without));
  RS_RETURN_IF_ERROR(CheckWorkspace(c.control.workspace, "control.workspace"));
  const LimiterOptions& limits = c.control.limits;
  if (!(limits.joint_velocity > 0 && limits.joint_velocity <= 3 && limits.joint_jerk > 0))
    return invalid("control.limits.joint_velocity is ", limits.joint_velocity,
                   " rad/s and joint_jerk ", limits.joint_jerk,
                   " rad/s^3; the first must be above 0, at most 3, the second above 0");
  for (const auto& [name, velocity] :
       {std::pair("home_velocity", c.home_velocity), std::pair("jog_velocity", c.jog_velocity)}) {
    if (!(velocity > 0 && velocity <= 1))
      return invalid(name, " is ", velocity, " rad/s, must be above 0, at most 1");
  }
  if (c.collision_level < -1 || c.collision_level > piper::kMostCollisionLevel)
    return invalid("collision_level is ", c.collision_level, ", must be 0 (off) to ",
                   piper::kMostCollisionLevel, ", or -1: as the arm has it");
  if (!c.policy.server.empty() && c.instruction.empty())
    return invalid("instruction is empty; give --instruction \"pick up the bowl ...\"");
  if (c.episodes < 1 || c.first_episode < 0 || c.task < 0)
    return invalid("task is ", c.task, ", first_episode ", c.first_episode, ", episodes ",
                   c.episodes, "; they must be at least 0, 0 and 1");
  if (!(c.episode_s > 0 && c.episode_s <= 3600))
    return invalid("episode_s is ", c.episode_s, ", must be above 0, at most 3600");
  RS_ASSIGN_OR_RETURN(const ArmAxes axes, AxesOf(c));
  if (!c.home.empty() && static_cast<int>(c.home.size()) != axes.count()) {
    return invalid("home has ", c.home.size(), " numbers, must have ", axes.count(), ": ",
                   axes.joints, " joints [rad]", axes.gripper ? " and the opening [m]" : "");
  }
  for (const double value : c.home) {
    if (!std::isfinite(value)) return invalid("home holds ", value, ", must be finite");
  }
  if (c.cameras.size() > 8) return invalid(c.cameras.size(), " cameras, at most 8");
  std::set<std::string> names;
  for (const std::string& camera : c.cameras) {
    const std::string name = camera.substr(0, camera.find('='));
    if (!names.insert(CameraInFileNames(name)).second)
      return invalid(
          "cameras has '", name,
          "' twice (what is no letter, digit, '-', '_' or '.' counts as '_'); rename one");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<FrameSource>> MakeCamera(const std::string& text, Clock* clock) {
  std::vector<std::string> parts = absl::StrSplit(text, absl::MaxSplits('=', 1));
  if (parts.size() != 2 || parts[0].empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("camera '", text, "' must be NAME=SOURCE, e.g. wrist=files:DIR"));
  }
  const std::string name = parts[0];
  const std::vector<std::string> pieces = absl::StrSplit(parts[1], absl::MaxSplits(",fault=", 1));
  RS_ASSIGN_OR_RETURN(std::unique_ptr<FrameSource> source, MakeSource(name, pieces[0], clock));
  if (pieces.size() == 1) return source;
  const std::vector<std::string> timed = absl::StrSplit(pieces[1], absl::MaxSplits('@', 1));
  const std::vector<std::string> kind = absl::StrSplit(timed[0], absl::MaxSplits(':', 1));
  CameraFault fault = CameraFault::kNone;
  RS_RETURN_IF_ERROR(ParseCameraFault(kind[0], &fault));
  double amount = 0, from_s = 0;
  if ((kind.size() == 2 && !absl::SimpleAtod(kind[1], &amount)) ||
      (timed.size() == 2 && !absl::SimpleAtod(timed[1], &from_s)) ||
      !(amount >= 0 && amount <= 1) || !(from_s >= 0 && from_s <= 1e6)) {
    return absl::InvalidArgumentError(
        absl::StrCat("camera '", name, "': fault '", pieces[1],
                     "' must be KIND[:AMOUNT][@SECONDS], AMOUNT from 0 to 1"));
  }
  auto faulty = std::make_unique<FaultySource>(std::move(source), clock);
  faulty->Set(fault, amount, clock->now_ns() + static_cast<int64_t>(from_s * 1e9));
  return std::unique_ptr<FrameSource>(std::move(faulty));
}

absl::StatusOr<std::unique_ptr<RobotArm>> MakeArm(const ClientConfig& config, Clock* clock) {
  if (config.bus == "rehearse")
    return std::unique_ptr<RobotArm>(std::make_unique<RehearsalArm>(RehearsalArmOptions{}, clock));
  if (IsBridge(config)) {
    RS_ASSIGN_OR_RETURN(bridge::BridgeRobot robot, bridge::LoadBridgeRobot(config.robot));
    if (const absl::Status chosen =
            bridge::ChooseWatched(config.control.workspace, config.home, robot);
        !chosen.ok())
      return absl::InvalidArgumentError(
          absl::StrCat(config.robot, ", or control.workspace over it: ", chosen.message()));
    robot.rate_hz = config.control.rate_hz;
    std::string address(absl::StripPrefix(config.bus, "bridge:"));
    return std::unique_ptr<RobotArm>(
        std::make_unique<bridge::BridgeArm>(std::move(robot), std::move(address), *clock));
  }
  RS_ASSIGN_OR_RETURN(std::unique_ptr<CanBus> bus, MakeCanBus(config.bus, *clock));
  piper::PiperArmOptions options;
  options.speed_percent = piper::PercentOf(
      std::max({config.control.limits.joint_velocity, config.home_velocity, config.jog_velocity}));
  std::random_device device;
  // Of two clients whose enable is typed at once one listens longer, and hears the other.
  options.enable_listen_ns +=
      std::uniform_int_distribution<int64_t>(0, options.enable_listen_ns)(device);
  return std::unique_ptr<RobotArm>(
      std::make_unique<piper::PiperArm>(std::move(bus), *clock, options));
}

std::unique_ptr<ArmModel> MakeModel(const ClientConfig& config, const RobotArm& arm) {
  if (const auto* behind = dynamic_cast<const bridge::BridgeArm*>(&arm)) {
    if (!behind->chain()) return nullptr;
    return std::make_unique<bridge::ChainModel>(*behind->chain(), config.control.workspace);
  }
  const auto* piper = dynamic_cast<const piper::PiperArm*>(&arm);
  const piper::Zero zero =
      piper == nullptr ? piper::Zero::kSince_1_6_3 : piper::ZeroOf(piper->firmware());
  return std::make_unique<piper::PiperModel>(zero, config.control.workspace);
}

}  // namespace robostress
