#include "robot_client/teach_run.h"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "common/status_macros.h"
#include "robot_client/can/bus_address.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/piper_arm.h"

namespace robostress {
namespace {

piper::JointVector JointsOf(const ArmVector& position) {
  piper::JointVector q;
  std::copy_n(position.begin(), piper::kJoints, q.begin());
  return q;
}

piper::Zero ZeroOf(const RobotArm& arm) {
  const auto* piper = dynamic_cast<const piper::PiperArm*>(&arm);
  return piper == nullptr ? piper::Zero::kSince_1_6_3 : piper::ZeroOf(piper->firmware());
}

// The first folder runs/NNN that is not there.
std::string NextRun(const std::string& directory) {
  for (int i = 0;; ++i) {
    const std::string run = absl::StrFormat("%s/runs/%03d", directory, i);
    if (!std::filesystem::exists(run)) return run;
  }
}

}  // namespace

absl::Status ParseTeachBy(const std::string& text, TeachOptions* options) {
  absl::string_view rest = text;
  if (text == "hand") {
    options->by = TeachOptions::By::kHand;
  } else if (text == "keyboard") {
    options->by = TeachOptions::By::kKeyboard;
  } else if (text == "gamepad") {
    options->by = TeachOptions::By::kGamepad;
    options->source = GamepadOptions().device;
  } else if (absl::ConsumePrefix(&rest, "gamepad:") && !rest.empty()) {
    options->by = TeachOptions::By::kGamepad;
    options->source = std::string(rest);
  } else if (absl::ConsumePrefix(&rest, "leader:") && !rest.empty()) {
    options->by = TeachOptions::By::kLeader;
    options->source = std::string(rest);
  } else {
    return absl::InvalidArgumentError(
        absl::StrCat("--by '", text,
                     "': expected hand, leader:BUS (as leader:can:can1), keyboard or "
                     "gamepad[:/dev/input/js0]"));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<TeachRun>> TeachRun::Create(ClientConfig config,
                                                           const TeachOptions& options,
                                                           OperatorConsole* console) {
  if (IsBridge(config))
    return absl::UnimplementedError(
        absl::StrCat("bus is ", config.bus,
                     ": teach moves a Piper; an arm behind a bridge is taught by the tools "
                     "of its driver"));
  if (config.instruction.empty())
    return absl::InvalidArgumentError(
        "instruction is empty; give --instruction \"open the top drawer\"");
  if (!(options.tool_velocity > 0 && options.tool_velocity <= 0.25))
    return absl::InvalidArgumentError(
        absl::StrCat("--speed is ", options.tool_velocity, " m/s, must be above 0, at most 0.25"));
  if (options.by == TeachOptions::By::kLeader && options.source == config.bus)
    return absl::InvalidArgumentError(
        absl::StrCat("--by leader:", options.source,
                     " is the follower's own bus, where the leader would command it past every "
                     "limit; give the leader a bus of its own"));
  config.policy.server.clear();
  if (options.by == TeachOptions::By::kHand) config.collision_level = -1;  // asked for, not written
  std::unique_ptr<TeachRun> teach(new TeachRun(config, options, console));
  RS_RETURN_IF_ERROR(teach->Open());
  return teach;
}

absl::Status TeachRun::Open() {
  if (options_.by == TeachOptions::By::kKeyboard)
    RS_RETURN_IF_ERROR(RawTerminal::Open(STDIN_FILENO).status());  // and back
  RS_ASSIGN_OR_RETURN(run_, ClientRun::Create(config_, NextRun(options_.directory)));
  RS_RETURN_IF_ERROR(OpenSource());
  return OpenWriter();
}

absl::Status TeachRun::OpenSource() {
  const double period_s = 1 / config_.control.rate_hz;
  const ArmLimits limits = run_->arm().limits();
  const SnapshotCell<JogInput>* input = nullptr;
  switch (options_.by) {
    case TeachOptions::By::kHand:
      return absl::OkStatus();
    case TeachOptions::By::kLeader: {
      RS_ASSIGN_OR_RETURN(std::unique_ptr<CanBus> bus, MakeCanBus(options_.source, run_->clock()));
      leader_ = std::make_unique<LeaderArm>(std::move(bus), &run_->clock());
      RS_RETURN_IF_ERROR(leader_->Connect());
      LeaderOptions leader;
      leader.joint_velocity =
          std::min(config_.home_velocity, config_.control.limits.joint_velocity);
      leader.period_s = period_s;
      live_ = std::make_unique<LeaderTarget>(&leader_->newest(), limits, leader);
      return absl::OkStatus();
    }
    case TeachOptions::By::kKeyboard:
      keys_ = std::make_unique<KeyInput>(&run_->clock());
      input = &keys_->input();
      break;
    case TeachOptions::By::kGamepad: {
      GamepadOptions gamepad;
      gamepad.device = options_.source;
      gamepad_ = std::make_unique<Gamepad>(gamepad, MakeGamepadFiles(), &run_->clock());
      RS_RETURN_IF_ERROR(gamepad_->Open());
      input = &gamepad_->input();
      break;
    }
  }
  JogOptions jog;
  jog.tool_velocity = options_.tool_velocity;
  jog.turn_velocity = 5 * options_.tool_velocity;
  jog.joint_velocity = config_.jog_velocity;
  jog.fastest_joint = std::min(config_.home_velocity, config_.control.limits.joint_velocity);
  jog.joint_margin = config_.control.limits.joint_margin;
  jog.period_s = period_s;
  const piper::Zero zero = ZeroOf(run_->arm());
  live_ = std::make_unique<JogTarget>(
      input,
      [zero](const ArmVector& position) { return piper::ToolJacobian(JointsOf(position), zero); },
      limits, jog);
  return absl::OkStatus();
}

absl::Status TeachRun::OpenWriter() {
  DemonstrationOptions options;
  options.directory = options_.directory;
  options.rate_hz = config_.control.rate_hz;
  options.keep_failures = options_.keep_failures;
  options.actions_are_next_states = by_hand();
  const std::vector<FrameSource*> cameras = run_->cameras();
  if (cameras.size() == 2) {
    const piper::Zero zero = ZeroOf(run_->arm());
    options.libero_tool = [zero](const ArmVector& position) {
      const Eigen::Isometry3d tool = piper::ToolPose(JointsOf(position), zero);
      return Pose{tool.translation(), Eigen::Quaterniond(tool.rotation())};
    };
  }
  RS_ASSIGN_OR_RETURN(writer_, DemonstrationWriter::Create(options, cameras, &run_->clock()));
  EpisodeTap::Options tap;
  tap.by_hand = by_hand();
  tap.period_s = 1 / config_.control.rate_hz;
  tap.stale_s = config_.control.watchdogs.arm_hold_s;
  tap_ = std::make_unique<EpisodeTap>(tap, writer_.get());
  run_->loop().OnTick([tap = tap_.get()](const TickRecord& record) { tap->Take(record); });
  return absl::OkStatus();
}

TeachRun::~TeachRun() {
  console_->GiveKeysTo(nullptr);
  if (saving_.valid()) saving_.wait();
  if (run_ != nullptr) run_->StopThreads();
}

std::string TeachRun::description() const {
  std::string guide;
  switch (options_.by) {
    case TeachOptions::By::kHand:
      guide = "by hand: press the teaching button on the arm, then type record";
      break;
    case TeachOptions::By::kLeader:
      guide = absl::StrCat(leader_->description(), ": enable, follow, then record");
      break;
    case TeachOptions::By::kKeyboard:
      guide = absl::StrCat("by keyboard: enable, follow, then keys\n", kKeyHelp);
      break;
    case TeachOptions::By::kGamepad:
      guide = absl::StrCat("by gamepad ", options_.source, ": enable, follow, then record\n",
                           kGamepadHelp);
      break;
  }
  const size_t cameras = config_.cameras.size();
  return absl::StrCat(run_->description(), "\ndemonstrations into ", options_.directory, " (",
                      writer_->episodes(), " there), ", guide, "\n",
                      cameras == 0   ? "no camera: states and actions in lerobot/ alone\n"
                      : cameras != 2 ? "libero/ is left out: its form has two cameras\n"
                                     : "");
}

void TeachRun::StartThreads() {
  if (leader_ != nullptr) leader_->StartThread();
  if (gamepad_ != nullptr) gamepad_->StartThread();
  run_->StartThreads();
}

absl::StatusOr<std::string> TeachRun::Record() {
  if (recording_)
    return absl::FailedPreconditionError(
        "a demonstration is under way; type success, failure or discard");
  if (saving_.valid())
    return absl::FailedPreconditionError("the last demonstration is still being written; wait");
  ControlLoop& loop = run_->loop();
  if (by_hand() && !loop.seen().taught)
    return absl::FailedPreconditionError(
        "the arm is not in teaching mode; press the teaching button on it, then type record");
  if (!by_hand() && !(following_ && loop.state() == ClientState::kMove))
    return absl::FailedPreconditionError(
        absl::StrCat("the client is ", StateName(loop.state()),
                     " and follows nobody; type enable, then follow, then record"));
  if (!by_hand() && tap_->joining())
    return absl::FailedPreconditionError(
        "the arm is still on its way to the leader; hold the leader still, then type record");
  RS_RETURN_IF_ERROR(writer_->Begin(config_.instruction));
  tap_->Open();
  recording_ = true;
  told_ = false;
  return absl::StrCat("recording demonstration ", writer_->episodes(), ": \"", config_.instruction,
                      "\"; success, failure or discard ends it");
}

absl::StatusOr<std::string> TeachRun::End(bool success) {
  if (!recording_) return absl::FailedPreconditionError("no demonstration is under way");
  tap_->Close();
  recording_ = false;
  if (const std::string spoiled = tap_->Spoiled(); !spoiled.empty() && success) {
    RS_RETURN_IF_ERROR(writer_->Discard());
    return absl::DataLossError(
        absl::StrCat("nothing was saved: after ", tap_->ticks(), " ticks ", spoiled));
  }
  saving_ = std::async(std::launch::async, [this, success] { return writer_->End(success); });
  return "";
}

absl::StatusOr<std::string> TeachRun::Discard() {
  if (!recording_) return absl::FailedPreconditionError("no demonstration is under way");
  tap_->Close();
  recording_ = false;
  RS_RETURN_IF_ERROR(writer_->Discard());
  return "the demonstration is dropped";
}

absl::StatusOr<std::string> TeachRun::Act(const OperatorOrder& order) {
  switch (order.command) {
    case OperatorCommand::kRecord:
      return Record();
    case OperatorCommand::kSuccess:
      return End(true);
    case OperatorCommand::kFailure:
      return End(false);
    case OperatorCommand::kDiscard:
      return Discard();
    case OperatorCommand::kStart:
    case OperatorCommand::kResume:
      return absl::FailedPreconditionError("no policy runs here; type follow or record");
    case OperatorCommand::kEnable:
    case OperatorCommand::kHome:
    case OperatorCommand::kJog:
    case OperatorCommand::kFollow:
      if (by_hand())
        return absl::FailedPreconditionError(
            "the arm is guided by hand and gets no command; for that start robot_client teach with "
            "--by leader:BUS, keyboard or gamepad");
      break;
    default:
      break;
  }
  if (order.command != OperatorCommand::kFollow) {
    if (order.command == OperatorCommand::kHome || order.command == OperatorCommand::kJog)
      following_ = false;
    return run_->Act(order);
  }
  if (keys_ != nullptr) keys_->Reset();
  following_ = true;
  return run_->FollowLive(live_.get());
}

// The terminal gives single keys while the arm follows them.
void TeachRun::WatchKeys() {
  const bool wanted = keys_ != nullptr && following_ && run_->loop().state() == ClientState::kMove;
  if (wanted == (raw_ != nullptr)) return;
  if (!wanted) {
    console_->GiveKeysTo(nullptr);
    raw_.reset();
    return Say("lines again: type orders");
  }
  absl::StatusOr<std::unique_ptr<RawTerminal>> raw = RawTerminal::Open(STDIN_FILENO);
  if (!raw.ok()) {
    run_->loop().Ask(kRequestHold);
    return Say(std::string(raw.status().message()));
  }
  raw_ = *std::move(raw);
  console_->GiveKeysTo(keys_.get());
}

absl::StatusOr<std::string> TeachRun::Watch() {
  WatchKeys();
  if (recording_ && !told_ && tap_->end() != EpisodeTap::End::kGoing) {
    told_ = true;
    const std::string spoiled = tap_->Spoiled();
    Say(spoiled.empty()
            ? absl::StrCat("the demonstration ends here, ", tap_->ticks(),
                           " ticks; type success, failure or discard")
            : absl::StrCat("the demonstration is worthless: ", spoiled, "; type discard"));
  }
  if (saving_.valid() && saving_.wait_for(std::chrono::seconds(0)) == std::future_status::ready) {
    const absl::StatusOr<DemonstrationSummary> saved = saving_.get();
    if (!saved.ok())
      return absl::Status(saved.status().code(),
                          absl::StrCat("nothing was saved: ", saved.status().message()));
    const int64_t missing = tap_->missing();
    return missing == 0 ? saved->text
                        : absl::StrCat(saved->text, ", ", missing, " ticks left out between");
  }
  return run_->Watch();
}

absl::Status TeachRun::Finish(bool limp) {
  if (!limp) run_->loop().Ask(kRequestHold);
  console_->GiveKeysTo(nullptr);
  raw_.reset();
  absl::Status first;
  if (limp) first = run_->Finish(true);
  if (saving_.valid()) {
    const absl::StatusOr<DemonstrationSummary> saved = saving_.get();
    Say(saved.ok() ? saved->text : std::string(saved.status().message()));
    first.Update(saved.status());
  }
  if (recording_) {
    Discard().status().IgnoreError();
    Say("the demonstration under way is dropped");
  }
  if (!limp) first.Update(run_->Finish(false));
  return first;
}

}  // namespace robostress
