#include "robot_client/control/watchdogs.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace robostress {
namespace {

double SecondsSince(int64_t now_ns, int64_t then_ns) {
  return static_cast<double>(now_ns - then_ns) * 1e-9;
}

bool Finite(const ArmSnapshot& arm) {
  const auto finite = [](const ArmVector& v) {
    return std::all_of(v.begin(), v.end(), [](double x) { return std::isfinite(x); });
  };
  return finite(arm.position) && finite(arm.velocity) && finite(arm.effort);
}

// Old, or of a time that has not come.
bool Stale(double age_s, double limit_s) { return age_s > limit_s || age_s < -kMostAhead_s; }

}  // namespace

void Watchdogs::OnRunStart(int64_t now_ns) {
  last_row_ns_ = now_ns;
  first_chunk_ = true;
  following_s_ = 0;
}

void Watchdogs::OnRow(int64_t now_ns) {
  last_row_ns_ = now_ns;
  first_chunk_ = false;
}

WatchdogVerdict Watchdogs::Check(const Inputs& in) {
  WatchdogVerdict verdict;
  if (!in.streaming) {
    following_s_ = 0;
    refused_sends_ = 0;
    return verdict;
  }
  // Later assignments outrank earlier ones: the arm itself last.
  if (in.oldest_camera_ns != std::numeric_limits<int64_t>::max()) {
    const double age = SecondsSince(in.now_ns, in.oldest_camera_ns);
    verdict.camera_late = Stale(age, options_.camera_mark_s);
    if (Stale(age, options_.camera_hold_s)) verdict.hold = StateCause::kCameraStale;
  }
  const double silent = SecondsSince(in.now_ns, last_row_ns_);
  if (in.running && verdict.hold == StateCause::kNone &&
      silent > (first_chunk_ ? options_.first_chunk_s : options_.server_hold_s))
    verdict.hold = StateCause::kServerSilent;
  double error = 0;
  for (int j = 0; j < joints_; ++j)
    error = std::max(error, std::abs(in.command[j] - in.arm.position[j]));
  following_s_ = error > options_.following_error ? following_s_ + period_s_ : 0;
  if (in.input_silent) verdict.hold = StateCause::kInputSilent;
  if (in.policy_invalid) verdict.hold = StateCause::kPolicyInvalid;
  if (in.record_failed) verdict.hold = StateCause::kRecordFailed;
  if (in.delay_s > options_.delay_hold_s) verdict.hold = StateCause::kDelayed;
  if (in.guarded) verdict.hold = StateCause::kWorkspace;
  if (following_s_ > options_.following_s) verdict.hold = StateCause::kFollowingError;
  if (in.blocked) verdict.hold = StateCause::kBlocked;
  if (in.pressing) verdict.hold = StateCause::kPressing;
  if (refused_sends_ >= options_.send_hold_ticks) verdict.hold = StateCause::kSendFailed;
  const double age = SecondsSince(in.now_ns, in.arm.stamp_ns);
  if (in.arm.sequence == 0 || Stale(age, options_.arm_hold_s))
    verdict.hold = StateCause::kArmSilent;

  if (refused_sends_ >= options_.send_fault_ticks) verdict.fault = StateCause::kSendFailed;
  if (in.arm.sequence == 0 || Stale(age, options_.arm_fault_s))
    verdict.fault = StateCause::kArmSilent;
  if (in.arm.sequence != 0 && !Finite(in.arm)) verdict.fault = StateCause::kNotFinite;
  if (in.arm.sequence != 0 && !in.arm.enabled) verdict.fault = StateCause::kArmDisabled;
  if (in.arm.faults != 0) verdict.fault = StateCause::kArmFault;
  return verdict;
}

}  // namespace robostress
