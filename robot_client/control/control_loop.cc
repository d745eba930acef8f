#include "robot_client/control/control_loop.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr double kNsPerSecond = 1e9;
// [rad], [m]. An arm without power hangs in its mechanical stops, up to 0.1 rad beyond J1, J3, J4,
// J5.
constexpr double kRestOutside = 0.12;

absl::Status CheckOptions(const ControlOptions& o) {
  const auto invalid = [](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  if (!(o.rate_hz >= 1 && o.rate_hz <= 1000))
    return invalid("rate_hz is ", o.rate_hz, ", must be 1..1000");
  if (o.player.execute_steps < 1 || o.player.late_steps < 0 ||
      o.player.execute_steps + o.player.late_steps > ArmChunk::kMaxRows) {
    return invalid("player.execute_steps is ", o.player.execute_steps, " and player.late_steps ",
                   o.player.late_steps, "; they must be at least 1 and 0, and together at most ",
                   ArmChunk::kMaxRows);
  }
  if (o.player.fade_steps < 0 || o.player.fade_steps > ArmChunk::kMaxRows)
    return invalid("player.fade_steps is ", o.player.fade_steps, ", must be 0..64");
  const DisturbanceObserverOptions& dob = o.disturbance_observer;
  if (!(dob.bandwidth > 0 && dob.max_correction > 0 && dob.min_dt_s > 0 &&
        dob.max_dt_s >= dob.min_dt_s && std::isfinite(dob.bandwidth + dob.max_dt_s))) {
    return invalid("disturbance_observer: bandwidth ", dob.bandwidth, ", max_correction ",
                   dob.max_correction, ", min_dt_s ", dob.min_dt_s, ", max_dt_s ", dob.max_dt_s,
                   "; all must be positive and max_dt_s at least min_dt_s");
  }
  const WatchdogOptions& w = o.watchdogs;
  if (!(w.arm_hold_s > 0 && w.arm_fault_s >= w.arm_hold_s))
    return invalid("watchdogs.arm_hold_s is ", w.arm_hold_s, " and arm_fault_s ", w.arm_fault_s,
                   "; both must be positive and the fault not before the hold");
  return absl::OkStatus();
}

// An arm at rest stands on its limits, and what it measures may lie a little beyond them: the first
// command is the nearest one that it takes.
absl::Status MoveInside(const ArmLimits& limits, ArmVector& position) {
  for (int i = 0; i < kArmAxes; ++i) {
    const double inside = std::clamp(position[i], limits.lower[i], limits.upper[i]);
    if (std::abs(inside - position[i]) > kRestOutside) {
      return absl::FailedPreconditionError(absl::StrCat(
          i < kArmJoints ? absl::StrCat("J", i + 1) : "the gripper", " stands at ", position[i],
          ", outside ", limits.lower[i], " to ", limits.upper[i], " by more than ", kRestOutside,
          ": take its power off, move it by hand, enable again"));
    }
    position[i] = inside;
  }
  return absl::OkStatus();
}

DisturbanceObserver::Joints JointsOf(const ArmVector& v) {
  return Eigen::Map<const Eigen::Matrix<double, kArmJoints, 1>>(v.data());
}

}  // namespace

ControlLoop::ControlLoop(const ControlOptions& options, RobotArm* arm, Clock* clock,
                         const CameraStamps* cameras)
    : options_(options),
      arm_(arm),
      clock_(clock),
      cameras_(cameras),
      player_(options.player),
      watchdogs_(options.watchdogs, 1 / options.rate_hz),
      observer_(options.disturbance_observer) {}

absl::StatusOr<std::unique_ptr<ControlLoop>> ControlLoop::Create(const ControlOptions& options,
                                                                 RobotArm* arm, Clock* clock,
                                                                 const CameraStamps* cameras) {
  RS_RETURN_IF_ERROR(CheckOptions(options));
  auto loop = std::unique_ptr<ControlLoop>(new ControlLoop(options, arm, clock, cameras));
  RS_RETURN_IF_ERROR(loop->limiter_.Configure(options.limits, arm->limits(), 1 / options.rate_hz));
  return loop;
}

absl::Status ControlLoop::enable_status() const {
  absl::MutexLock lock(&mu_);
  return enable_status_;
}

bool ControlLoop::streaming() const {
  const ClientState state = machine_.state();
  return state == ClientState::kEnabled || state == ClientState::kRun ||
         state == ClientState::kHold;
}

uint32_t ControlLoop::StopRequests(int64_t now_ns) {
  const int presses = stop_presses_ == nullptr ? 0 : stop_presses_->load(std::memory_order_acquire);
  if (presses == seen_presses_) return 0;
  const bool again = presses > seen_presses_ + 1 ||
                     (seen_presses_ > 0 &&
                      static_cast<double>(now_ns - last_press_ns_) < kStopWindow_s * kNsPerSecond);
  seen_presses_ = presses;
  last_press_ns_ = now_ns;
  return again ? kRequestQuickStop : kRequestHold;
}

void ControlLoop::EnableArm() {
  enabling_ = true;
  ArmSnapshot arm = arm_->Latest();
  ArmVector start = arm.position;
  absl::Status status = MoveInside(arm_->limits(), start);  // refused while it has no power yet
  if (status.ok()) status = arm_->Enable();
  arm_->Poll();
  arm = arm_->Latest();
  start = arm.position;
  if (status.ok() && (arm.sequence == 0 || !arm.enabled)) {
    status = absl::UnavailableError(
        "the arm says that it is enabled, but no complete sample shows it; look at the bus");
  }
  if (status.ok()) status = MoveInside(arm_->limits(), start);
  if (status.ok()) {
    limiter_.Reset(start);
    machine_.Enabled();
  }
  absl::MutexLock lock(&mu_);
  enable_status_ = std::move(status);
}

void ControlLoop::TakeChunks(int64_t now_ns) {
  while (chunks_.Pop(incoming_)) {
    const bool answers = waiting_ && incoming_.request == request_id_;
    if (answers) waiting_ = false;
    if (incoming_.failed) {
      if (answers) retry_after_ns_ = now_ns + static_cast<int64_t>(options_.retry_s * kNsPerSecond);
      continue;
    }
    if (!answers || machine_.state() != ClientState::kRun ||
        player_.Offer(incoming_, now_ns, limiter_.position()) != ChunkVerdict::kTaken)
      record_.flags |= kTickRejected;
  }
}

void ControlLoop::AskForPrediction(int64_t now_ns) {
  if (machine_.state() != ClientState::kRun || waiting_ || now_ns < retry_after_ns_) return;
  const bool due =
      !asked_before_ || player_.empty() ||
      player_.played() >= asked_played_ + static_cast<uint64_t>(options_.player.execute_steps);
  if (!due) return;
  PredictionRequest request;
  request.id = request_id_ + 1;
  request.episode = record_.episode;
  request.chunk = next_chunk_;
  request.played = player_.played();
  request.asked_ns = now_ns;
  request.position = record_.position;
  if (!prediction_requests_.Push(request)) return;  // its reader is stuck; the watchdog sees it
  ++request_id_;
  ++next_chunk_;
  waiting_ = asked_before_ = true;
  asked_played_ = request.played;
  record_.flags |= kTickRequested;
  if (on_request_) on_request_();
}

void ControlLoop::OnStateChange(ClientState before, int64_t now_ns) {
  const ClientState now = machine_.state();
  if (now == ClientState::kRun) {
    waiting_ = asked_before_ = false;
    retry_after_ns_ = 0;
    player_.Clear();
    observer_.Reset();
    if (before == ClientState::kEnabled) {
      record_.episode = episode_.load(std::memory_order_relaxed) + 1;
      episode_.store(record_.episode, std::memory_order_release);
      player_.StartEpisode(record_.episode);
      next_chunk_ = 0;
    }
    watchdogs_.OnRunStart(now_ns);
  } else {
    player_.Clear();
    waiting_ = false;
  }
}

void ControlLoop::PickTarget(int64_t now_ns) {
  record_.chunk = record_.row = -1;
  record_.prediction_id = 0;
  if (!streaming()) return;
  ChunkPlayer::Step step;
  if (machine_.state() == ClientState::kRun && player_.Next(step)) {
    watchdogs_.OnRow(now_ns);
    record_.flags |= kTickPlayed;
    if (step.entered) record_.flags |= kTickEntered;
    if (step.fading) record_.flags |= kTickFading;
    if (step.overrun) record_.flags |= kTickOverrun;
    record_.chunk = step.chunk;
    record_.row = step.row;
    record_.prediction_id = step.prediction_id;
    record_.policy = step.policy;
    record_.requested = step.requested;
    record_.blended = record_.corrected = step.blended;
    if (options_.observer) Correct();
    record_.sent = limiter_.Limit(record_.corrected);
    double moved = 0;
    for (int i = 0; i < kArmAxes; ++i)
      moved = std::max(moved, std::abs(record_.sent[i] - record_.corrected[i]));
    if (moved > 0) record_.flags |= kTickLimited;
  } else {
    if (machine_.state() == ClientState::kRun) record_.flags |= kTickStarved;
    record_.sent = limiter_.Decelerate();
    record_.blended = record_.corrected = record_.sent;
  }
  record_.limiter = limiter_.flags();
  if (options_.observer && observer_.estimate().size() > 0)
    observer_.Applied(JointsOf(record_.sent));
}

void ControlLoop::Correct() {
  const DisturbanceObserver::Joints target = JointsOf(record_.blended);
  const double dt = static_cast<double>(record_.start_ns - observed_ns_) / kNsPerSecond;
  const bool fresh = (record_.flags & kTickFresh) != 0;
  const DisturbanceObserver::Joints corrected =
      fresh ? observer_.Correct(target, JointsOf(record_.position), dt)
            : observer_.CorrectUnmeasured(target);
  if (fresh) observed_ns_ = record_.start_ns;
  for (int j = 0; j < kArmJoints; ++j) record_.corrected[j] = corrected[j];
  record_.flags |= kTickObserver;
}

void ControlLoop::SendCommand() {
  if (machine_.quick_stop()) {
    arm_->QuickStop().IgnoreError();  // repeated every tick, whatever becomes of it
    return;
  }
  if (!streaming()) return;
  const bool taken =
      arm_->Send({.position = record_.sent, .gripper_effort = options_.gripper_effort}).ok();
  watchdogs_.OnSend(taken);
  if (taken) record_.flags |= kTickSent;
}

void ControlLoop::Publish() {
  for (Reader& reader : readers_) {
    TickRecord record = record_;
    if (reader.lost) record.flags |= kTickLost;
    reader.lost = !reader.ring->Push(record);
  }
}

void ControlLoop::Tick(int64_t due_ns) {
  const int64_t now = clock_->now_ns();
  enabling_ = false;
  arm_->Poll();
  const uint32_t requests = asked_.exchange(0, std::memory_order_acq_rel) | StopRequests(now);
  if ((requests & kRequestEnable) && machine_.state() == ClientState::kIdle &&
      !(requests & (kRequestHold | kRequestQuickStop)))
    EnableArm();
  const ArmSnapshot arm = arm_->Latest();

  ++record_.tick;
  record_.due_ns = due_ns;
  record_.start_ns = enabling_ ? clock_->now_ns() : now;
  record_.flags = 0;
  record_.limiter = 0;
  record_.faults = arm.faults;
  record_.position = arm.position;
  record_.velocity = arm.velocity;
  record_.effort = arm.effort;
  record_.stamp_ns = arm.stamp_ns;
  record_.sequence = arm.sequence;
  if (arm.sequence != last_sequence_) record_.flags |= kTickFresh;
  last_sequence_ = arm.sequence;

  Watchdogs::Inputs inputs;
  inputs.now_ns = record_.start_ns;
  inputs.arm = arm;
  inputs.oldest_camera_ns = cameras_->Oldest();
  inputs.streaming = streaming();
  inputs.running = machine_.state() == ClientState::kRun;
  inputs.command = limiter_.position();
  const WatchdogVerdict verdict = watchdogs_.Check(inputs);
  if (verdict.camera_late) record_.flags |= kTickCameraLate;

  const ClientState before = machine_.state();
  if (machine_.Advance(requests, verdict, arm.faults)) OnStateChange(before, record_.start_ns);
  record_.state = machine_.state();
  record_.cause = machine_.cause();
  state_.store(record_.state, std::memory_order_release);

  TakeChunks(record_.start_ns);
  AskForPrediction(record_.start_ns);
  if (on_request_) TakeChunks(record_.start_ns);
  PickTarget(record_.start_ns);
  SendCommand();
  record_.sent_ns = clock_->now_ns();
  Publish();
}

void ControlLoop::Run(const std::atomic<bool>& stop) {
  const auto period = static_cast<int64_t>(kNsPerSecond / options_.rate_hz);
  int64_t due = clock_->now_ns() + period;
  while (!stop.load(std::memory_order_acquire)) {
    clock_->SleepUntil(due);
    Tick(due);
    const int64_t done = clock_->now_ns();
    if (!enabling_) timing_.Add(record_.start_ns - due, record_.sent_ns - due);
    due += period;
    if (done >= due) {
      const int64_t passed = (done - due) / period + 1;
      if (!enabling_) {
        ++timing_.missed;
        timing_.skipped += static_cast<uint64_t>(passed);
      }
      due += passed * period;
    }
  }
}

}  // namespace robostress
