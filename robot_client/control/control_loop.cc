#include "robot_client/control/control_loop.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr double kArrived = 0.03;   // [rad] from the end of a way ...
constexpr double kArrives_s = 1.5;  // ... within so long of its last row
constexpr double kGuarded_s = 0.5;  // without a way out of the workspace's bounds: HOLD
constexpr int kLookAhead = 100;     // ticks of braking that are looked at; each asks the model once

DisturbanceObserver::Joints JointsOf(const ArmVector& v, int joints) {
  return Eigen::Map<const Eigen::VectorXd>(v.data(), joints);
}

}  // namespace

ControlLoop::ControlLoop(const ControlOptions& options, RobotArm* arm, Clock* clock,
                         const CameraStamps* cameras, const ArmModel* model)
    : options_(options),
      arm_(arm),
      clock_(clock),
      cameras_(cameras),
      model_(options.guards ? model : nullptr),
      joints_(arm->axes().joints),
      player_(options.player, joints_),
      watchdogs_(options.watchdogs, 1 / options.rate_hz, joints_),
      observer_(options.disturbance_observer),
      press_(options.press, 1 / options.rate_hz, model_, joints_),
      delay_(1 / options.rate_hz, joints_) {
  record_.axes = arm->axes();
}

absl::StatusOr<std::unique_ptr<ControlLoop>> ControlLoop::Create(const ControlOptions& options,
                                                                 RobotArm* arm, Clock* clock,
                                                                 const CameraStamps* cameras,
                                                                 const ArmModel* model) {
  RS_RETURN_IF_ERROR(CheckControlOptions(options, arm->axes().joints));
  auto loop = std::unique_ptr<ControlLoop>(new ControlLoop(options, arm, clock, cameras, model));
  RS_RETURN_IF_ERROR(loop->limiter_.Configure(options.limits, arm->limits(), 1 / options.rate_hz));
  RS_RETURN_IF_ERROR(loop->CheckLookAhead());
  return loop;
}

bool ControlLoop::guards_workspace() const { return model_ != nullptr && options_.workspace.guard; }

absl::Status ControlLoop::CheckLookAhead() const {
  for (int i = 0; i < axes().count() && guards_workspace(); ++i) {
    const int ticks = limiter_.BrakingTicks(i);
    if (ticks < kLookAhead) continue;
    const LimiterOptions& o = options_.limits;
    const std::string limits =
        i < joints_
            ? absl::StrCat("joint_velocity is ", o.joint_velocity, " rad/s, joint_acceleration ",
                           o.joint_acceleration, " rad/s^2, joint_jerk ", o.joint_jerk, " rad/s^3")
            : absl::StrCat("gripper_velocity is ", o.gripper_velocity,
                           " m/s, gripper_acceleration ", o.gripper_acceleration, " m/s^2");
    return absl::InvalidArgumentError(absl::StrCat(
        "control.limits: ", limits, ", or the arm's own where lower, and control.rate_hz ",
        options_.rate_hz, ": ", axes().name(i), " brakes for up to ", ticks,
        " ticks, and table, box and the arm itself are looked for in ", kLookAhead,
        "; lower the velocity or the rate, or raise the acceleration"));
  }
  return absl::OkStatus();
}

void ControlLoop::TakeChunks(int64_t now_ns) {
  while (chunks_.Pop(incoming_)) {
    const bool answers = waiting_ && incoming_.request == request_id_;
    if (answers) waiting_ = false;
    if (incoming_.failed) {
      policy_invalid_ = policy_invalid_ || (answers && incoming_.invalid);
      if (answers) retry_after_ns_ = now_ns + static_cast<int64_t>(options_.retry_s * kNsPerSecond);
      continue;
    }
    if (!answers || machine_.state() != ClientState::kRun) {
      record_.flags |= kTickRejected;
      continue;
    }
    const ChunkVerdict verdict = player_.Offer(incoming_, now_ns, limiter_.position());
    if (verdict != ChunkVerdict::kTaken) record_.flags |= kTickRejected;
    if (verdict == ChunkVerdict::kNotFinite || verdict == ChunkVerdict::kWrongShape)
      policy_invalid_ = true;
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
  request.running = player_.chunk();
  request.row = player_.row();
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
  held_.Begin(record_.position);
  guarded_ticks_ = 0;
  policy_invalid_ = false;
  way_ = nullptr;
  live_ = nullptr;
  delay_.Reset();
  if (now == ClientState::kMove) {
    live_ = next_live_.load(std::memory_order_acquire);
    if (live_ != nullptr) live_->Begin(limiter_.position());
    if (live_ == nullptr) way_ = path_.load(std::memory_order_acquire);
    way_row_ = 0;
    watchdogs_.OnRunStart(now_ns);
  }
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

// The next command on the way to a target, unless it, or a command of braking from it, crosses a
// bound of the workspace: then it brakes now, which was seen to be free when the last command was.
ArmVector ControlLoop::Advance(const ArmVector& target) {
  if (!guards_workspace()) return limiter_.Limit(target);
  CommandLimiter next = limiter_;
  ArmModel::Clearance before = model_->ClearanceAt(limiter_.position());
  const ArmVector command = next.Limit(target);
  CommandLimiter braking = next;
  for (int i = 0; i < kLookAhead; ++i) {
    const ArmModel::Clearance now = model_->ClearanceAt(braking.position());
    if (const ArmModel::Bound bound = CrossedBound(before, now); bound != ArmModel::kBounds) {
      crossed_.store(bound, std::memory_order_release);
      break;
    }
    if (braking.at_rest()) {
      guarded_ticks_ = 0;
      limiter_ = next;
      return command;
    }
    before = now;
    braking.Decelerate();
  }
  record_.flags |= kTickGuarded;
  ++guarded_ticks_;
  return limiter_.Decelerate();
}

// Stands, or comes to stand, or gives way.
ArmVector ControlLoop::Stand() {
  const bool fresh = (record_.flags & kTickFresh) != 0;
  if (options_.guards && fresh && machine_.state() != ClientState::kRun) {
    held_.Take(record_, press_, machine_.state() == ClientState::kHold, limiter_.position(),
               limiter_.at_rest());
  }
  if (!held_.target()) return limiter_.Decelerate();
  record_.flags |= kTickRelaxed;
  return Advance(*held_.target());
}

// A row of the policy's chunk; false: there is none.
bool ControlLoop::PlayRow(int64_t now_ns) {
  ChunkPlayer::Step step;
  if (!player_.Next(step)) return false;
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
  for (int j = 0; j < joints_; ++j)
    record_.corrected[j] += options_.smoothing * (limiter_.position()[j] - record_.corrected[j]);
  return true;
}

// A row of the client's own way; false: there is none.
bool ControlLoop::PlayPath() {
  if (way_ == nullptr || way_->rows.empty()) return false;
  const ArmVector& end = way_->rows.back();
  record_.row = static_cast<int32_t>(way_row_);
  const bool over = way_row_ >= way_->rows.size();
  record_.blended = record_.corrected = over ? end : way_->rows[way_row_];
  ++way_row_;
  if (!over) return true;
  double off = 0;
  for (int j = 0; j < joints_; ++j) off = std::max(off, std::abs(record_.position[j] - end[j]));
  const double waited = static_cast<double>(way_row_ - way_->rows.size()) / options_.rate_hz;
  if ((off < kArrived && limiter_.at_rest()) || waited > kArrives_s) {
    machine_.Arrived();
    way_ = nullptr;
  }
  return true;
}

// What somebody wants live; false: nobody does.
bool ControlLoop::PlayLive(int64_t now_ns) {
  if (live_ == nullptr) return false;
  const LiveRow row = live_->Next(now_ns, limiter_.position());
  record_.policy = record_.requested = row.wanted;
  record_.blended = record_.corrected = row.target;
  record_.flags |= kTickLive | (row.joining ? kTickJoining : 0u);
  return true;
}

void ControlLoop::PickTarget(int64_t now_ns) {
  record_.chunk = record_.row = -1;
  record_.prediction_id = 0;
  if (!machine_.streaming()) return;
  const bool runs = machine_.state() == ClientState::kRun;
  const bool target =
      runs ? PlayRow(now_ns)
           : machine_.state() == ClientState::kMove && (PlayLive(now_ns) || PlayPath());
  if (target) {
    record_.sent = Advance(record_.corrected);
    double moved = 0;
    for (int i = 0; i < record_.axes.count(); ++i)
      moved = std::max(moved, std::abs(record_.sent[i] - record_.corrected[i]));
    if (moved > 0) record_.flags |= kTickLimited;
  } else {
    if (runs) record_.flags |= kTickStarved;
    record_.sent = Stand();
    record_.blended = record_.corrected = record_.sent;
  }
  record_.limiter = limiter_.flags();
  if (options_.observer && observer_.estimate().size() > 0)
    observer_.Applied(JointsOf(record_.sent, joints_));
}

void ControlLoop::Correct() {
  const DisturbanceObserver::Joints target = JointsOf(record_.blended, joints_);
  const double dt = static_cast<double>(record_.start_ns - observed_ns_) / kNsPerSecond;
  const bool fresh = (record_.flags & kTickFresh) != 0;
  const DisturbanceObserver::Joints corrected =
      fresh ? observer_.Correct(target, JointsOf(record_.position, joints_), dt)
            : observer_.CorrectUnmeasured(target, 1 / options_.rate_hz);
  if (fresh) observed_ns_ = record_.start_ns;
  for (int j = 0; j < joints_; ++j) record_.corrected[j] = corrected[j];
  record_.flags |= kTickObserver;
}

void ControlLoop::SendCommand() {
  if (machine_.quick_stop()) {
    arm_->QuickStop().IgnoreError();  // repeated every tick, whatever becomes of it
    return;
  }
  if (!machine_.streaming()) return;
  const bool taken =
      arm_->Send({.position = record_.sent, .gripper_effort = options_.gripper_effort}).ok();
  watchdogs_.OnSend(taken);
  if (taken) record_.flags |= kTickSent;
}

void ControlLoop::StopPressing(const ArmSnapshot& arm) {
  const StateCause cause = machine_.cause();
  const bool pressed = cause == StateCause::kPressing || cause == StateCause::kBlocked ||
                       cause == StateCause::kFollowingError;
  if (!options_.guards || !pressed || (record_.flags & kTickFresh) == 0) return;
  const std::optional<ArmVector> stand =
      held_.LetGo(arm_->limits(), arm.position, limiter_.position());
  if (!stand) return;
  limiter_.Reset(*stand);
  record_.flags |= kTickRelaxed;
}

// A fault sends nothing any more, and the arm would go on pressing towards its last target: that
// becomes where it stands, once. The gripper keeps what it holds, unless the fault is its own.
void ControlLoop::LetGo(const ArmSnapshot& arm) {
  const StateCause cause = machine_.cause();
  const bool known = cause != StateCause::kArmSilent && cause != StateCause::kNotFinite &&
                     cause != StateCause::kSendFailed;
  const bool grips_badly = (arm.faults & kFaultGripper) != 0;  // its motor need not strain on
  if (!options_.guards || machine_.quick_stop() || !known || !arm.enabled ||
      (arm.faults & kFaultForeignCommand) != 0 || (Apart(arm) <= kRelax && !grips_badly)) {
    return;
  }
  ArmVector stand = arm.position;
  if (!MoveInside(arm_->limits(), stand).ok()) return;
  if (grips_badly) grips_ = false;
  if (grips_) KeepOpening(stand);
  record_.sent = stand;
  if (arm_->Send({.position = stand, .gripper_effort = options_.gripper_effort}).ok())
    record_.flags |= kTickSent | kTickRelaxed;
}

// What a gripper holds stands off its command for as long as it is held: there it is let go.
void ControlLoop::KeepOpening(ArmVector& position) const {
  position[axes().opening()] = limiter_.position()[axes().opening()];
}

void ControlLoop::WatchContact(const ArmSnapshot& arm) {
  record_.excess.fill(0);
  record_.delay_s = std::numeric_limits<double>::quiet_NaN();
  if (!options_.guards || !machine_.streaming()) return;
  const bool moves =
      machine_.state() == ClientState::kRun || machine_.state() == ClientState::kMove;
  if ((record_.flags & kTickFresh) != 0) {
    press_.Take(arm, limiter_.position());
    if (moves) delay_.Take(limiter_.position(), arm.position);
  }
  record_.excess = press_.excess();
  if (const auto delay = delay_.delay_s(); delay && moves) record_.delay_s = *delay;
}

bool ControlLoop::Settled() const {
  if (!machine_.streaming()) return true;
  const bool moves =
      machine_.state() == ClientState::kRun || machine_.state() == ClientState::kMove;
  return !moves && limiter_.at_rest() &&
         std::all_of(record_.velocity.begin(), record_.velocity.begin() + joints_,
                     [](double v) { return std::abs(v) < kStill; });
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
  if (!arm_->Latest().enabled) grips_ = false;  // limp: somebody's fingers may be between its own
  settled_.store(false, std::memory_order_release);  // before what was asked for is taken
  const uint32_t requests = asked_.exchange(0, std::memory_order_acq_rel) | StopRequests(now);
  if ((requests & kRequestEnable) && machine_.state() == ClientState::kIdle &&
      !(requests & (kRequestHold | kRequestQuickStop)))
    EnableArm();
  ArmSnapshot arm = arm_->Latest();

  ++record_.tick;
  record_.due_ns = due_ns;
  record_.start_ns = enabling_ ? clock_->now_ns() : now;
  record_.flags = 0;
  record_.limiter = 0;
  record_.faults = arm.faults;
  record_.fault_joints = arm.fault_joints;
  record_.position = arm.position;
  record_.velocity = arm.velocity;
  record_.effort = arm.effort;
  record_.stamp_ns = arm.stamp_ns;
  record_.sequence = arm.sequence;
  if (arm.sequence != last_sequence_) record_.flags |= kTickFresh;
  if (arm.taught) record_.flags |= kTickTaught;
  last_sequence_ = arm.sequence;

  WatchContact(arm);
  const bool moves =
      machine_.state() == ClientState::kRun || machine_.state() == ClientState::kMove;
  Watchdogs::Inputs inputs;
  inputs.now_ns = record_.start_ns;
  inputs.arm = arm;
  // A way of the client's own needs no eyes.
  const bool blind = machine_.state() == ClientState::kMove ||
                     ((requests & kRequestMove) && !(requests & kRequestStart));
  inputs.oldest_camera_ns = blind ? std::numeric_limits<int64_t>::max() : cameras_->Oldest();
  inputs.streaming = machine_.streaming();
  inputs.running = machine_.state() == ClientState::kRun;
  inputs.command = limiter_.position();
  inputs.pressing = press_.pressing();
  inputs.blocked = moves && press_.blocked();
  inputs.guarded = guarded_ticks_ > kGuarded_s * options_.rate_hz;
  inputs.record_failed = record_failed_.load(std::memory_order_acquire);
  inputs.policy_invalid = std::exchange(policy_invalid_, false);
  const LiveTarget* live = (requests & kRequestMove) && live_ == nullptr
                               ? next_live_.load(std::memory_order_acquire)
                               : live_;
  inputs.input_silent = live != nullptr && live->Silent(record_.start_ns);
  inputs.delay_s = std::isfinite(record_.delay_s) ? record_.delay_s : 0;
  const WatchdogVerdict verdict = watchdogs_.Check(inputs);
  if (verdict.camera_late) record_.flags |= kTickCameraLate;

  const ClientState before = machine_.state();
  const uint32_t granted = Granted(requests, arm, verdict, record_.start_ns);
  if (machine_.Advance(granted, verdict, arm.faults)) OnStateChange(before, record_.start_ns);
  if (machine_.state() == ClientState::kFault && before != ClientState::kFault &&
      before != ClientState::kIdle)
    LetGo(arm);
  if (machine_.state() == ClientState::kHold && before != ClientState::kHold) StopPressing(arm);
  record_.state = machine_.state();
  record_.cause = machine_.cause();
  cause_.store(record_.cause, std::memory_order_release);
  state_.store(record_.state, std::memory_order_release);
  seen_.Store(arm);
  if ((requests & (kGoing | kRequestEnable | kRequestResume)) != 0)
    decided_.fetch_add(1, std::memory_order_acq_rel);

  TakeChunks(record_.start_ns);
  AskForPrediction(record_.start_ns);
  if (on_request_) TakeChunks(record_.start_ns);
  PickTarget(record_.start_ns);
  SendCommand();
  record_.sent_ns = clock_->now_ns();
  opening_.store(limiter_.position()[axes().opening()], std::memory_order_release);
  settled_.store(Settled(), std::memory_order_release);
  if (on_tick_) on_tick_(record_);
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
