#include "robot_client/client_run.h"

#include <pthread.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/records/arm_episode.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "robot_client/bridge/bridge_arm.h"
#include "robot_client/piper/piper_arm.h"

namespace robostress {
namespace {

constexpr int64_t kPoll_ns = 5'000'000;
constexpr char kEpisodes[] = "/episodes.jsonl";
constexpr double kEnables_s = 10;
constexpr double kReconnects_s = 10;  // a driver that was started again
constexpr double kLastFeedback_s = 0.1;
constexpr double kBrakes_s = 2;  // an end waits so long for the arm's rest

}  // namespace

absl::StatusOr<std::unique_ptr<ClientRun>> ClientRun::Create(const ClientConfig& config,
                                                             const std::string& directory,
                                                             const MotionMaker& motion) {
  RS_RETURN_IF_ERROR(CheckConfig(config));
  auto run = std::unique_ptr<ClientRun>(new ClientRun(config, directory));
  RS_RETURN_IF_ERROR(run->Open(motion));
  return run;
}

absl::Status ClientRun::Open(const MotionMaker& motion) {
  RS_ASSIGN_OR_RETURN(arm_, MakeArm(config_, &clock_));
  RS_RETURN_IF_ERROR(arm_->Connect());
  RS_RETURN_IF_ERROR(CheckCollisionProtection());
  if (const auto* behind = dynamic_cast<const bridge::BridgeArm*>(arm_.get())) {
    for (std::string& line : behind->Warnings()) Say(std::move(line));
    if (behind->chain() && !config_.control.workspace.guard)
      Say("WARNING: control.workspace.guard is false: table and box are NOT watched");
  }
  model_ = MakeModel(config_, *arm_);
  if (!config_.home.empty()) {
    const bool guarded = config_.control.workspace.guard;
    RS_RETURN_IF_ERROR(
        CheckPose("home", HomeOf(config_), arm_->limits(), guarded ? model_.get() : nullptr));
  }
  std::vector<FrameSource*> sources;
  for (const std::string& text : config_.cameras) {
    RS_ASSIGN_OR_RETURN(std::unique_ptr<FrameSource> camera, MakeCamera(text, &clock_));
    RS_RETURN_IF_ERROR(camera->Start());
    sources.push_back(camera.get());
    cameras_.push_back(std::move(camera));
  }
  stamps_ = std::make_unique<FrameStamps>(sources, &clock_);
  RS_ASSIGN_OR_RETURN(loop_, ControlLoop::Create(config_.control, arm_.get(), &clock_,
                                                 stamps_.get(), model_.get()));
  ways_ = std::make_unique<OwnWays>(config_, *arm_, model_.get(), loop_.get(), &clock_,
                                    [this](std::string line) { Say(std::move(line)); });
  if (motion) {
    RS_ASSIGN_OR_RETURN(Motion played, motion(arm_->limits(), model_.get()));
    RS_RETURN_IF_ERROR(ways_->Take(std::move(played)));
  }
  loop_->ObeyStops(OperatorConsole::presses(), OperatorConsole::gentle_presses());
  if (!config_.policy.server.empty()) {
    PolicyLinkOptions link;
    link.instruction = config_.instruction;
    link.max_frame_age_s = config_.control.watchdogs.camera_hold_s;
    link.feedback = config_.feedback;
    link.rtc_rows = config_.control.player.rtc_rows;
    link_ = std::make_unique<PolicyLink>(link, loop_.get(), &clock_, sources,
                                         ConnectTo(config_.policy, 1 / config_.control.rate_hz));
    RS_RETURN_IF_ERROR(link_->Open());
  }
  RS_ASSIGN_OR_RETURN(recorder_, Recorder::Create(directory_, arm_->axes()));
  RS_RETURN_IF_ERROR(WriteFileAtomically(directory_ + "/config.yaml", DumpConfig(config_)));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> joints, RigNamesOf(config_));
  RS_RETURN_IF_ERROR(WriteFileAtomically(
      directory_ + "/arm.json",
      nlohmann::ordered_json{{"joints", joints}, {"gripper", arm_->axes().gripper}}.dump() + "\n"));
  if (const auto& motion_played = ways_->motion())
    RS_RETURN_IF_ERROR(WriteFileAtomically(directory_ + "/motion.csv", MotionCsv(*motion_played)));
  loop_->AddReader(&recorder_->ring());
  arm_->AddSampleReader(&recorder_->samples());
  if (link_ != nullptr) link_->RecordFrames(&recorder_->frames(), config_.record_pictures);
  loop_->AddReader(&reporter_.ring());
  return absl::OkStatus();
}

// The arm's own protection is another layer; without it a person must know.
absl::Status ClientRun::CheckCollisionProtection() {
  auto* arm = dynamic_cast<piper::PiperArm*>(arm_.get());
  if (arm == nullptr) return absl::OkStatus();
  if (config_.collision_level >= 0) {
    RS_RETURN_IF_ERROR(arm->SetCollisionLevel(config_.collision_level));
  } else {
    RS_RETURN_IF_ERROR(arm->AskCollisionLevels());
  }
  const auto& levels = arm->collision_levels();
  if (!levels) {
    Say("the arm does not say how its collision protection is set");
    return absl::OkStatus();
  }
  Say(absl::StrCat("the arm's collision protection, J1 to J6: ", absl::StrJoin(*levels, " ")));
  if (std::count(levels->begin(), levels->end(), 0) > 0)
    Say("WARNING: it is off where a 0 stands; collision_level 1 to 8 in the configuration sets it");
  return absl::OkStatus();
}

ClientRun::~ClientRun() { StopThreads(); }

std::string ClientRun::description() const {
  const std::optional<Motion>& motion = ways_->motion();
  const std::string policy =
      motion ? absl::StrFormat("motion %s, %.1f s: enable, then play slow", motion->source,
                               motion->duration_s())
      : link_ == nullptr
          ? "no policy server: enable, jog and home only"
          : absl::StrCat("policy ", link_->spec().name, " at ", config_.policy.server,
                         "; cameras [", absl::StrJoin(link_->spec().cameras, ", "), "]");
  const std::string without =
      config_.without.empty()
          ? ""
          : absl::StrCat("\nWITHOUT the guards: ", absl::StrJoin(config_.without, ", "));
  return absl::StrCat(arm_->description(), "; ", policy, without);
}

void ClientRun::StartThreads() {
  threads_ = true;
  reporting_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "reporter");
    reporter_.Run(stop_others_);
  });
  recording_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "recorder");
    recording_status_ = recorder_->Run(stop_others_, [this](const absl::Status& error) {
      Say(std::string(error.message()));
      if (config_.record_required) loop_->NoteRecordFailed();
    });
  });
  if (link_ != nullptr) {
    policy_ = std::thread([this] {
      pthread_setname_np(pthread_self(), "policy");
      link_->Run(stop_others_);
    });
  }
  control_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "control");
    realtime_ = MakeRealtime(config_.realtime);
    control_ready_.store(true, std::memory_order_release);
    control_ready_.notify_one();
    loop_->Run(stop_control_);
  });
  control_ready_.wait(false, std::memory_order_acquire);
  Say("control thread: " + realtime_);
}

// The last command stays the arm's target: in mid-motion it would be an emergency stop, and behind
// a bridge the way back to where the arm was measured.
void ClientRun::Brake() {
  loop_->Ask(kRequestHold);
  const int64_t until = clock_.now_ns() + static_cast<int64_t>(kBrakes_s * 1e9);
  while (!loop_->settled() && clock_.now_ns() < until)
    clock_.SleepUntil(clock_.now_ns() + kPoll_ns);
}

void ClientRun::StopThreads() {
  if (!threads_) return;
  threads_ = false;
  if (control_.joinable()) {
    Brake();
    stop_control_ = true;
    control_.join();  // the arm stays at its last target
  }
  stop_others_ = true;
  if (link_ != nullptr) {
    link_->Wake();
    policy_.join();
  }
  recording_.join();
  reporting_.join();
}

absl::StatusOr<std::string> ClientRun::Enable() {
  if (loop_->state() != ClientState::kIdle)
    return absl::FailedPreconditionError(absl::StrCat("the client is ", StateName(loop_->state()),
                                                      "; only from IDLE the arm is enabled"));
  const uint64_t before = loop_->decided();
  pending_ = PendingAnswer{"enable", clock_.now_ns() + static_cast<int64_t>(kEnables_s * 1e9),
                           [this, before]() -> std::optional<absl::StatusOr<std::string>> {
                             if (loop_->decided() == before) return std::nullopt;
                             if (const absl::Status status = loop_->enable_status(); !status.ok())
                               return status;
                             if (loop_->state() == ClientState::kIdle)
                               return absl::CancelledError("enable was stopped before it began");
                             return "the arm has power and holds";
                           },
                           absl::DeadlineExceededError("the arm was not enabled within 10 s")};
  loop_->Ask(kRequestEnable);
  return "";
}

absl::StatusOr<std::string> ClientRun::Clear() {
  if (loop_->state() != ClientState::kFault)
    return absl::FailedPreconditionError("there is no fault to clear");
  pending_ = AwaitDecision(
      loop_.get(), clock_, "clear", kReconnects_s,
      [this] { return loop_->state() == ClientState::kIdle; },
      "no fault any more; type enable when it is safe");
  loop_->Ask(kRequestClear);
  return "";
}

absl::StatusOr<std::string> ClientRun::StartEpisode() {
  if (link_ == nullptr) {
    return absl::FailedPreconditionError(
        "no policy server is configured; quit, and start again with --server HOST:PORT");
  }
  if (episode_running_) {
    return absl::FailedPreconditionError("an episode runs; end it first (success, failure or end)");
  }
  if (done()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "all ", config_.episodes, " episodes of this run are done; quit, and run the next task"));
  }
  if (loop_->state() != ClientState::kEnabled) {
    return absl::FailedPreconditionError(absl::StrCat("the client is ", StateName(loop_->state()),
                                                      "; an episode starts from ENABLED"));
  }
  const int episode = config_.first_episode + next_episode_;
  link_->StartEpisode({config_.task, episode});
  pending_ = AwaitDecision(
      loop_.get(), clock_, "start", kDecides_s,
      [this] {
        // It may have been held in its first ticks.
        episode_running_ =
            loop_->state() == ClientState::kRun || loop_->state() == ClientState::kHold;
        episode_start_ns_ = clock_.now_ns();
        at_start_ = link_->counters();
        return episode_running_;
      },
      absl::StrCat("episode ", episode, " of task ", config_.task, ": \"", config_.instruction,
                   "\""));
  loop_->Ask(kRequestStart);
  return "";
}

absl::StatusOr<std::string> ClientRun::StartWay(const OperatorOrder& order) {
  if (episode_running_) {
    return absl::FailedPreconditionError(
        absl::StrCat("the client is ", StateName(loop_->state()),
                     " and an episode runs; end it first (success, failure or end)"));
  }
  RS_ASSIGN_OR_RETURN(pending_, order.command == OperatorCommand::kHome ? ways_->Home()
                                : order.command == OperatorCommand::kJog
                                    ? ways_->Jog(order.axis, order.amount)
                                    : ways_->Play(order.amount));
  return "";
}

std::vector<FrameSource*> ClientRun::cameras() const {
  std::vector<FrameSource*> sources;
  for (const auto& camera : cameras_) sources.push_back(camera.get());
  return sources;
}

absl::StatusOr<std::string> ClientRun::FollowLive(LiveTarget* live) {
  if (busy())
    return absl::FailedPreconditionError(absl::StrCat(pending_->what, " goes on; Enter stops it"));
  if (loop_->state() != ClientState::kEnabled) {
    return absl::FailedPreconditionError(absl::StrCat("the client is ", StateName(loop_->state()),
                                                      "; the arm follows from ENABLED"));
  }
  pending_ = AwaitDecision(
      loop_.get(), clock_, "follow", kDecides_s,
      [this] { return loop_->state() == ClientState::kMove; }, "the arm follows; Enter stops");
  loop_->Follow(live);
  return "";
}

absl::StatusOr<std::string> ClientRun::EndEpisode(std::optional<bool> success) {
  if (!episode_running_) {
    if (loop_->state() != ClientState::kHold) {
      return absl::FailedPreconditionError("no episode runs");
    }
    loop_->Ask(kRequestEnd);  // a way of the client's own was held
    return "the arm stands; type home, jog or start";
  }
  loop_->Ask(kRequestEnd);
  if (link_ != nullptr) link_->Wake();
  // Time for the last chunk's feedback; in FAULT the episode is over as it is.
  const int64_t enough = clock_.now_ns() + static_cast<int64_t>(kLastFeedback_s * 1e9);
  pending_ = PendingAnswer{"end", clock_.now_ns() + static_cast<int64_t>(kDecides_s * 1e9),
                           [this, success, enough]() -> std::optional<absl::StatusOr<std::string>> {
                             const ClientState state = loop_->state();
                             const bool over =
                                 state != ClientState::kRun && state != ClientState::kHold;
                             if (!over || clock_.now_ns() < enough) return std::nullopt;
                             return CountEpisode(success);
                           },
                           absl::DeadlineExceededError("the episode does not end")};
  return "";
}

absl::StatusOr<std::string> ClientRun::CountEpisode(std::optional<bool> success) {
  episode_running_ = false;
  const PolicyLinkCounters now = link_->counters();
  ArmEpisode row;
  row.task = config_.task;
  row.episode = config_.first_episode + next_episode_;
  row.success = success;
  row.seconds = static_cast<double>(clock_.now_ns() - episode_start_ns_) * 1e-9;
  row.predictions = now.predictions - at_start_.predictions;
  row.failed_predictions = now.failed_predictions - at_start_.failed_predictions;
  row.failed_feedback = now.failed_feedback - at_start_.failed_feedback;
  row.feedback_chunks = now.feedback_sent - at_start_.feedback_sent;
  row.steps = now.feedback.steps - at_start_.feedback.steps;
  row.steps_masked = now.feedback.steps_masked - at_start_.feedback.steps_masked;
  row.residual = now.residual.value();
  row.adapter_version = now.adapter_version;
  row.sessions = now.sessions;
  row.state = StateName(loop_->state());
  ++next_episode_;
  RS_RETURN_IF_ERROR(AppendLine(directory_ + kEpisodes, ArmEpisodeLine(row)));
  return absl::StrFormat("episode ended; %d of %d done; residual %.1f %%, adapter version %d",
                         next_episode_, config_.episodes, 100 * now.residual.value(),
                         now.adapter_version);
}

absl::StatusOr<std::string> ClientRun::Act(const OperatorOrder& order) {
  switch (order.command) {  // what stops the arm comes first, whatever goes on
    case OperatorCommand::kHold:
      ways_->Stop();
      loop_->Ask(kRequestHold);
      return "hold";
    case OperatorCommand::kQuickStop:
      ways_->Stop();
      loop_->Ask(kRequestQuickStop);
      return arm_->stop_effect();
    case OperatorCommand::kQuit:
    case OperatorCommand::kQuitLimp:
      return "quit";
    default:
      break;
  }
  if (busy())
    return absl::FailedPreconditionError(
        absl::StrCat(pending_->what, " goes on; Enter stops it, or wait for its end"));
  switch (order.command) {
    case OperatorCommand::kEnable:
      return Enable();
    case OperatorCommand::kHome:
    case OperatorCommand::kJog:
    case OperatorCommand::kPlay:
      return StartWay(order);
    case OperatorCommand::kStart:
      return StartEpisode();
    case OperatorCommand::kResume:
      if (loop_->state() != ClientState::kHold || !episode_running_)
        return absl::FailedPreconditionError("no episode is held; type end, then start or home");
      pending_ = PendingAnswer{
          "resume", clock_.now_ns() + static_cast<int64_t>(0.5e9),
          [this, before = loop_->decided()]() -> std::optional<absl::StatusOr<std::string>> {
            if (loop_->decided() != before && loop_->refusal() == Refusal::kOutside)
              return Refused(*loop_, "resume");
            if (loop_->state() != ClientState::kRun) return std::nullopt;
            return "the episode goes on";
          },
          absl::FailedPreconditionError(
              "still HOLD: what holds the arm is still there; see events.jsonl")};
      loop_->Ask(kRequestResume);
      return "";
    case OperatorCommand::kSuccess:
      return EndEpisode(true);
    case OperatorCommand::kFailure:
      return EndEpisode(false);
    case OperatorCommand::kEnd:
      return EndEpisode(std::nullopt);
    case OperatorCommand::kClear:
      return Clear();
    case OperatorCommand::kFollow:
    case OperatorCommand::kRecord:
    case OperatorCommand::kDiscard:
      return absl::FailedPreconditionError(
          "demonstrations are recorded by robot_client teach; see robot_client teach --help");
    default:
      return absl::InternalError("unknown order");
  }
}

// What a server answers that refuses an observation: the loop knows only that no chunk came.
void ClientRun::TellServersError() {
  if (link_ == nullptr || loop_->state() != ClientState::kHold) return;
  const std::string error(link_->last_error().message());
  if (error.empty() || error == told_error_) return;
  told_error_ = error;
  Say("the server's last error: " + error);
}

absl::StatusOr<std::string> ClientRun::Watch() {
  TellServersError();
  if (pending_) {
    std::optional<absl::StatusOr<std::string>> answer = pending_->answer();
    if (!answer && clock_.now_ns() < pending_->until_ns) return "";
    if (!answer) answer = pending_->late;
    pending_ = ways_->TakeNext();
    return *std::move(answer);
  }
  if (!episode_running_) return "";
  const double seconds = static_cast<double>(clock_.now_ns() - episode_start_ns_) * 1e-9;
  if (seconds < config_.episode_s) return "";
  return EndEpisode(std::nullopt);
}

absl::Status ClientRun::Finish(bool limp) {
  absl::Status first;
  if (limp) {
    stop_control_ = true;
    if (threads_) control_.join();
    first = arm_->Disable();
    Say(first.ok() ? "the joints have no power" : std::string(first.message()));
  }
  pending_.reset();
  if (episode_running_) {
    if (!limp) {
      loop_->Ask(kRequestEnd);
      if (link_ != nullptr) link_->Wake();
      const int64_t until = clock_.now_ns() + static_cast<int64_t>(kLastFeedback_s * 1e9);
      while (clock_.now_ns() < until) clock_.SleepUntil(clock_.now_ns() + kPoll_ns);
    }
    first.Update(CountEpisode(std::nullopt).status());
  }
  StopThreads();
  first.Update(recording_status_);
  if (recording_status_.ok()) first.Update(recorder_->Finish());
  RS_RETURN_IF_ERROR(first);
  RS_RETURN_IF_ERROR(WriteFileAtomically(directory_ + "/timing.json", loop_->timing().Json()));
  return WriteFileAtomically(directory_ + "/DONE", "");
}

}  // namespace robostress
