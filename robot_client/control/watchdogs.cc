#include "robot_client/control/watchdogs.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"

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

absl::Status CheckWatchdogs(const WatchdogOptions& o, const std::vector<std::string>& given_up) {
  const struct {
    const char* name;
    double value, least, most;
  } ranges[] = {{"arm_hold_s", o.arm_hold_s, 0.01, 0.2},
                {"arm_fault_s", o.arm_fault_s, std::min(o.arm_hold_s, 0.2), 1},
                {"camera_mark_s", o.camera_mark_s, 0.01, 1},
                {"camera_hold_s", o.camera_hold_s, 0.05, 2},
                {"server_hold_s", o.server_hold_s, 0.1, 10},
                {"first_chunk_s", o.first_chunk_s, 0.1, 120},
                {"following_error", o.following_error, 0.01, 1},
                {"following_s", o.following_s, 0.05, 2},
                {"send_hold_ticks", static_cast<double>(o.send_hold_ticks), 1, 30},
                {"send_fault_ticks", static_cast<double>(o.send_fault_ticks),
                 static_cast<double>(std::min(o.send_hold_ticks, 60)), 60},
                {"delay_hold_s", o.delay_hold_s, 0.05, 0.5}};
  for (const auto& [name, value, least, most] : ranges) {
    if (value >= least && value <= most) continue;
    if (value > 0 && std::count(given_up.begin(), given_up.end(), name) > 0) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("control.watchdogs.", name, " is ", value, ", must be ", least, " to ", most,
                     ": beyond that it guards nothing; --without ", name, " gives the guard up"));
  }
  for (const std::string& name : given_up) {
    const bool known = std::any_of(std::begin(ranges), std::end(ranges),
                                   [&](const auto& range) { return name == range.name; });
    if (!known)
      return absl::InvalidArgumentError(
          absl::StrCat("--without ", name, ": no watchdog has this name"));
  }
  return absl::OkStatus();
}

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
