#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "robot_client/control/control_loop.h"

// What the control loop is asked for and what of it is granted; how it gives an arm power.
namespace robostress {
namespace {

constexpr double kTogether = 0.1;  // [rad] an arm stands where it is sent

}  // namespace

absl::Status ControlLoop::enable_status() const {
  absl::MutexLock lock(&mu_);
  return enable_status_;
}

uint32_t ControlLoop::StopRequests(int64_t now_ns) {
  const auto count = [](const std::atomic<int>* presses) {
    return presses == nullptr ? 0 : presses->load(std::memory_order_acquire);
  };
  const int gentle = count(gentle_presses_);
  const uint32_t hold = std::exchange(seen_gentle_, gentle) != gentle ? kRequestHold : 0u;
  const int presses = count(stop_presses_);
  if (presses == seen_presses_) return hold;
  const bool again = presses > seen_presses_ + 1 ||
                     (seen_presses_ > 0 &&
                      static_cast<double>(now_ns - last_press_ns_) < kStopWindow_s * kNsPerSecond);
  seen_presses_ = presses;
  last_press_ns_ = now_ns;
  return again ? kRequestQuickStop : kRequestHold;
}

bool ControlLoop::StopAsked() const {
  if ((asked_.load(std::memory_order_acquire) & (kRequestHold | kRequestQuickStop)) != 0)
    return true;
  const auto pressed = [](const std::atomic<int>* presses, int seen) {
    return presses != nullptr && presses->load(std::memory_order_acquire) != seen;
  };
  return pressed(stop_presses_, seen_presses_) || pressed(gentle_presses_, seen_gentle_);
}

Refusal ControlLoop::WhyNot(const ArmSnapshot& arm, int64_t now_ns) const {
  const double age = static_cast<double>(now_ns - arm.stamp_ns) / kNsPerSecond;
  if (arm.sequence == 0 || !(age <= options_.watchdogs.arm_hold_s && age >= -kMostAhead_s))
    return Refusal::kStale;
  for (int j = 0; j < joints_; ++j) {
    if (!(std::abs(arm.velocity[j]) < kStill)) return Refusal::kMoving;
  }
  return Refusal::kNone;
}

double ControlLoop::Apart(const ArmSnapshot& arm) const {
  double apart = 0;
  for (int j = 0; j < joints_; ++j)
    apart = std::max(apart, std::abs(limiter_.position()[j] - arm.position[j]));
  return apart;
}

// What of the requests is obeyed: an arm is set going only where it is known to stand now.
uint32_t ControlLoop::Granted(uint32_t requests, ArmSnapshot& arm, const WatchdogVerdict& verdict,
                              int64_t now_ns) {
  if ((requests & (kGoing | kRequestResume)) == 0) return requests;
  const bool clears = (requests & kRequestClear) && machine_.state() == ClientState::kFault;
  Refusal why = Refusal::kNone;
  if (clears) {
    if (arm_->lost()) {
      if (!ReconnectArm().ok()) why = Refusal::kLost;
      now_ns = record_.start_ns;
    }
    arm_->Acknowledge();
    arm_->Poll();
    arm = arm_->Latest();
  }
  if ((requests & kGoing) && why == Refusal::kNone && options_.guards) why = WhyNot(arm, now_ns);
  if (clears && why == Refusal::kNone && arm.faults != 0) why = Refusal::kFaults;
  if ((requests & (kRequestStart | kRequestMove)) && why == Refusal::kNone) {
    if (options_.guards && Apart(arm) > kTogether) why = Refusal::kApart;
    if (verdict.hold != StateCause::kNone) why = Refusal::kHeld;
  }
  if ((requests & (kRequestStart | kRequestResume)) && why == Refusal::kNone && Outside())
    why = Refusal::kOutside;
  refusal_.store(why, std::memory_order_release);
  return why == Refusal::kNone ? requests : requests & ~(kGoing | kRequestResume);
}

// Where one part is beyond a bound it hides how far the others go: a person leads the arm out.
bool ControlLoop::Outside() {
  if (!guards_workspace()) return false;
  const ArmModel::Clearance clearance = model_->ClearanceAt(limiter_.position());
  const ArmModel::Bound bound = BrokenBound(clearance);
  if (bound == ArmModel::kBounds) return false;
  crossed_.store(bound, std::memory_order_release);
  outside_m_.store(-clearance[bound], std::memory_order_release);
  return true;
}

absl::Status ControlLoop::reconnect_status() const {
  absl::MutexLock lock(&mu_);
  return reconnect_status_;
}

// The tick goes on later, with the time that it is then.
absl::Status ControlLoop::ReconnectArm() {
  enabling_ = true;
  grips_ = false;
  absl::Status status = arm_->Reconnect([this] { return StopAsked(); });
  record_.start_ns = clock_->now_ns();
  absl::MutexLock lock(&mu_);
  return reconnect_status_ = std::move(status);
}

void ControlLoop::EnableArm() {
  enabling_ = true;
  absl::Status status;
  if (arm_->lost()) status = ReconnectArm();
  ArmSnapshot arm = arm_->Latest();
  ArmVector start = arm.position;
  status.Update(MoveInside(arm_->limits(), start));  // refused while it has no power yet
  const auto ready = [&] {
    const int64_t now = clock_->now_ns();
    switch (options_.guards ? WhyNot(arm, now) : Refusal::kNone) {
      case Refusal::kStale:
        return absl::UnavailableError(absl::StrCat(
            "the newest sample of the arm is ",
            arm.sequence == 0 ? "not there" : absl::StrCat((now - arm.stamp_ns) / 1'000'000, " ms"),
            " old, at most ", 1000 * options_.watchdogs.arm_hold_s,
            " ms are allowed: where it stands is not known; look at the bus, then type enable"));
      case Refusal::kMoving:
        return absl::FailedPreconditionError(
            "the arm moves; wait until it stands, then type enable");
      default:
        return absl::OkStatus();
    }
  };
  if (status.ok()) status = ready();
  if (status.ok()) status = arm_->Enable([this] { return StopAsked(); });
  arm_->Poll();
  arm = arm_->Latest();
  start = arm.position;
  if (status.ok()) status = ready();
  if (status.ok() && (arm.sequence == 0 || !arm.enabled)) {
    status = absl::UnavailableError(
        "the arm says that it is enabled, but no complete sample shows it; look at the bus");
  }
  if (status.ok()) status = MoveInside(arm_->limits(), start);
  if (status.ok()) {
    if (grips_) KeepOpening(start);
    grips_ = true;
    limiter_.Reset(start);
    press_.Reset();
    held_.Begin(start);
    machine_.Enabled();
  }
  absl::MutexLock lock(&mu_);
  enable_status_ = std::move(status);
}

}  // namespace robostress
