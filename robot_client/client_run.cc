#include "robot_client/client_run.h"

#include <pthread.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "robot_client/homing_endpoint.h"

namespace robostress {
namespace {

constexpr int64_t kPoll_ns = 5'000'000;
constexpr char kEpisodes[] = "/episodes.jsonl";
constexpr double kHomingMost_s = 15;

ArmVector HomeOf(const ClientConfig& config) {
  ArmVector home{};
  std::copy_n(config.home.begin(), home.size(), home.begin());
  return home;
}

}  // namespace

absl::StatusOr<std::unique_ptr<ClientRun>> ClientRun::Create(const ClientConfig& config,
                                                             const std::string& directory) {
  RS_RETURN_IF_ERROR(CheckConfig(config));
  auto run = std::unique_ptr<ClientRun>(new ClientRun(config, directory));
  RS_RETURN_IF_ERROR(run->Open());
  return run;
}

absl::Status ClientRun::Open() {
  RS_ASSIGN_OR_RETURN(arm_, MakeArm(config_, &clock_));
  RS_RETURN_IF_ERROR(arm_->Connect());
  std::vector<FrameSource*> sources;
  for (const std::string& text : config_.cameras) {
    RS_ASSIGN_OR_RETURN(std::unique_ptr<FrameSource> camera, MakeCamera(text, &clock_));
    RS_RETURN_IF_ERROR(camera->Start());
    sources.push_back(camera.get());
    cameras_.push_back(std::move(camera));
  }
  stamps_ = std::make_unique<FrameStamps>(sources, &clock_);
  RS_ASSIGN_OR_RETURN(loop_,
                      ControlLoop::Create(config_.control, arm_.get(), &clock_, stamps_.get()));
  loop_->ObeyStops(OperatorConsole::presses());
  PolicyLinkOptions link;
  link.instruction = config_.instruction;
  link.max_frame_age_s = config_.control.watchdogs.camera_hold_s;
  link.feedback = config_.feedback;
  link_ = std::make_unique<PolicyLink>(link, loop_.get(), &clock_, sources, ConnectWithHome());
  RS_RETURN_IF_ERROR(link_->Open());
  RS_ASSIGN_OR_RETURN(recorder_, Recorder::Create(directory_));
  RS_RETURN_IF_ERROR(WriteFileAtomically(directory_ + "/config.yaml", DumpConfig(config_)));
  loop_->AddReader(&recorder_->ring());
  arm_->AddSampleReader(&recorder_->samples());
  link_->RecordFrames(&recorder_->frames());
  recorder_->OnChange([](const std::string& line) { std::printf("%s\n", line.c_str()); });
  return absl::OkStatus();
}

// The server's policy, with the way home before it where there is one.
PolicyLink::Connect ClientRun::ConnectWithHome() const {
  const double period_s = 1 / config_.control.rate_hz;
  PolicyLink::Connect connect = ConnectTo(config_.policy, period_s);
  if (config_.home.empty()) return connect;
  return [connect, period_s,
          home = HomeOf(config_)]() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
    RS_ASSIGN_OR_RETURN(std::unique_ptr<PolicyEndpoint> policy, connect());
    return std::make_unique<HomingEndpoint>(std::move(policy), home, period_s);
  };
}

ClientRun::~ClientRun() { StopThreads(); }

std::string ClientRun::description() const {
  return absl::StrCat(arm_->description(), "; policy ", link_->spec().name, " at ",
                      config_.policy.server, "; cameras [",
                      absl::StrJoin(link_->spec().cameras, ", "), "]");
}

void ClientRun::StartThreads() {
  threads_ = true;
  recording_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "recorder");
    recording_status_ = recorder_->Run(stop_others_);
  });
  policy_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "policy");
    link_->Run(stop_others_);
  });
  control_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "control");
    realtime_ = MakeRealtime(config_.realtime);
    control_ready_.store(true, std::memory_order_release);
    control_ready_.notify_one();
    loop_->Run(stop_control_);
  });
  control_ready_.wait(false, std::memory_order_acquire);
  std::printf("control thread: %s\n", realtime_.c_str());
}

void ClientRun::StopThreads() {
  if (!threads_) return;
  threads_ = false;
  stop_control_ = true;
  control_.join();  // the arm stays at its last target
  stop_others_ = true;
  link_->Wake();
  policy_.join();
  recording_.join();
}

bool ClientRun::WaitForState(ClientState state, double seconds) {
  const int64_t until = clock_.now_ns() + static_cast<int64_t>(seconds * 1e9);
  while (loop_->state() != state && clock_.now_ns() < until)
    clock_.SleepUntil(clock_.now_ns() + kPoll_ns);
  return loop_->state() == state;
}

absl::StatusOr<std::string> ClientRun::StartEpisode() {
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
  loop_->Ask(kRequestStart);
  if (!WaitForState(ClientState::kRun, 1)) {
    return absl::UnavailableError(
        "the episode did not start: arm or camera are not fresh; see events.jsonl");
  }
  episode_running_ = true;
  episode_start_ns_ = clock_.now_ns();
  at_start_ = link_->counters();
  return absl::StrCat("episode ", episode, " of task ", config_.task, ": \"", config_.instruction,
                      "\"");
}

absl::StatusOr<std::string> ClientRun::GoHome() {
  if (config_.home.empty()) {
    return absl::FailedPreconditionError(
        "no starting pose is configured; give home (six joints [rad] and the opening [m])");
  }
  if (episode_running_ || loop_->state() != ClientState::kEnabled) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the client is ", StateName(loop_->state()), episode_running_ ? " and an episode runs" : "",
        "; home is reached from ENABLED"));
  }
  const ArmVector home = HomeOf(config_);
  link_->StartEpisode({config_.task, kHomingEpisode});
  loop_->Ask(kRequestStart);
  if (!WaitForState(ClientState::kRun, 1)) {
    return absl::UnavailableError(
        "the way home did not begin: arm or camera are not fresh; see events.jsonl");
  }
  const int64_t until = clock_.now_ns() + static_cast<int64_t>(kHomingMost_s * 1e9);
  bool there = false;
  while (!there && loop_->state() == ClientState::kRun && clock_.now_ns() < until) {
    clock_.SleepUntil(clock_.now_ns() + kPoll_ns);
    there = IsHome(arm_->Latest().position, home);
  }
  loop_->Ask(kRequestEnd);
  const bool enabled = WaitForState(ClientState::kEnabled, 2);
  if (there && enabled) return "the arm is home";
  return absl::DeadlineExceededError(absl::StrCat("the arm did not come home within ",
                                                  kHomingMost_s, " s; the client is ",
                                                  StateName(loop_->state()), ", see events.jsonl"));
}

absl::StatusOr<std::string> ClientRun::EndEpisode(std::optional<bool> success) {
  if (!episode_running_) return absl::FailedPreconditionError("no episode runs");
  loop_->Ask(kRequestEnd);
  // In FAULT the episode is over as it is.
  WaitForState(ClientState::kEnabled, 0.5);
  link_->Wake();
  clock_.SleepUntil(clock_.now_ns() + 20 * kPoll_ns);  // the last chunk's feedback
  episode_running_ = false;
  const PolicyLinkCounters now = link_->counters();
  nlohmann::ordered_json row = {
      {"task", config_.task},
      {"episode", config_.first_episode + next_episode_},
      {"success", success ? nlohmann::ordered_json(*success) : nlohmann::ordered_json(nullptr)},
      {"seconds", static_cast<double>(clock_.now_ns() - episode_start_ns_) * 1e-9},
      {"predictions", now.predictions - at_start_.predictions},
      {"failed_predictions", now.failed_predictions - at_start_.failed_predictions},
      {"feedback_chunks", now.feedback_sent - at_start_.feedback_sent},
      {"steps", now.feedback.steps - at_start_.feedback.steps},
      {"steps_masked", now.feedback.steps_masked - at_start_.feedback.steps_masked},
      {"residual", now.residual.value()},
      {"adapter_version", now.adapter_version},
      {"sessions", now.sessions},
      {"state", StateName(loop_->state())}};
  ++next_episode_;
  RS_RETURN_IF_ERROR(AppendLine(directory_ + kEpisodes, row.dump()));
  return absl::StrFormat("episode ended; %d of %d done; residual %.1f %%, adapter version %d",
                         next_episode_, config_.episodes, 100 * now.residual.value(),
                         now.adapter_version);
}

absl::StatusOr<std::string> ClientRun::Act(OperatorCommand command) {
  switch (command) {
    case OperatorCommand::kEnable: {
      if (loop_->state() != ClientState::kIdle)
        return absl::FailedPreconditionError(absl::StrCat(
            "the client is ", StateName(loop_->state()), "; only from IDLE the arm is enabled"));
      loop_->Ask(kRequestEnable);
      if (WaitForState(ClientState::kEnabled, 10)) return "the arm has power and holds";
      const absl::Status status = loop_->enable_status();
      return status.ok() ? absl::DeadlineExceededError("the arm was not enabled within 10 s")
                         : status;
    }
    case OperatorCommand::kHome:
      return GoHome();
    case OperatorCommand::kStart:
      return StartEpisode();
    case OperatorCommand::kHold:
      loop_->Ask(kRequestHold);
      return "hold";
    case OperatorCommand::kResume:
      loop_->Ask(kRequestResume);
      if (WaitForState(ClientState::kRun, 0.5)) return "the episode goes on";
      return absl::FailedPreconditionError(absl::StrCat(
          "still ", StateName(loop_->state()),
          ": what holds the arm is still there, or nothing was held; see events.jsonl"));
    case OperatorCommand::kSuccess:
      return EndEpisode(true);
    case OperatorCommand::kFailure:
      return EndEpisode(false);
    case OperatorCommand::kEnd:
      return EndEpisode(std::nullopt);
    case OperatorCommand::kClear:
      loop_->Ask(kRequestClear);
      if (WaitForState(ClientState::kIdle, 0.5)) return "no fault any more; enable when it is safe";
      return absl::FailedPreconditionError(
          absl::StrCat("still ", StateName(loop_->state()), ": the arm goes on reporting a fault"));
    case OperatorCommand::kQuickStop:
      loop_->Ask(kRequestQuickStop);
      return "damped stop: the arm sinks";
    case OperatorCommand::kQuit:
    case OperatorCommand::kQuitLimp:
      return "quit";
  }
  return absl::InternalError("unknown command");
}

absl::Status ClientRun::Watch() {
  if (!episode_running_) return absl::OkStatus();
  const double seconds = static_cast<double>(clock_.now_ns() - episode_start_ns_) * 1e-9;
  if (seconds < config_.episode_s) return absl::OkStatus();
  return EndEpisode(std::nullopt).status();
}

absl::Status ClientRun::Finish(bool limp) {
  if (episode_running_) RS_RETURN_IF_ERROR(EndEpisode(std::nullopt).status());
  StopThreads();
  if (limp) RS_RETURN_IF_ERROR(arm_->Disable());
  RS_RETURN_IF_ERROR(recording_status_);
  RS_RETURN_IF_ERROR(recorder_->Finish());
  RS_RETURN_IF_ERROR(WriteFileAtomically(directory_ + "/timing.json", loop_->timing().Json()));
  return WriteFileAtomically(directory_ + "/DONE", "");
}

}  // namespace robostress
