#include "robot_client/control/control_options.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

absl::Status CheckPress(const PressOptions& o, int joints) {
  const struct {
    const char* name;
    const std::vector<double>& values;
    double least;
  } vectors[] = {
      {"excess", o.excess, 0.01}, {"friction", o.friction, 0}, {"viscous", o.viscous, 0}};
  for (const auto& [name, values, least] : vectors) {
    if (static_cast<int>(values.size()) != joints) {
      return absl::InvalidArgumentError(absl::StrCat(
          "press.", name, " has ", values.size(), " numbers, must have one per joint: ", joints));
    }
    for (const double value : values) {
      if (!(value >= least && value <= 100))
        return absl::InvalidArgumentError(
            absl::StrCat("press.", name, " holds ", value, ", must be ", least, " to 100"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckGuards(const WatchdogOptions& w, const PressOptions& p,
                         const std::vector<std::string>& given_up) {
  const struct {
    const char *section, *name;
    double value, least, most;
  } ranges[] = {{"watchdogs", "arm_hold_s", w.arm_hold_s, 0.01, 0.2},
                {"watchdogs", "arm_fault_s", w.arm_fault_s, std::min(w.arm_hold_s, 0.2), 1},
                {"watchdogs", "camera_mark_s", w.camera_mark_s, 0.01, 1},
                {"watchdogs", "camera_hold_s", w.camera_hold_s, 0.05, 2},
                {"watchdogs", "server_hold_s", w.server_hold_s, 0.1, 10},
                {"watchdogs", "first_chunk_s", w.first_chunk_s, 0.1, 120},
                {"watchdogs", "following_error", w.following_error, 0.01, 1},
                {"watchdogs", "following_s", w.following_s, 0.05, 2},
                {"watchdogs", "send_hold_ticks", static_cast<double>(w.send_hold_ticks), 1, 30},
                {"watchdogs", "send_fault_ticks", static_cast<double>(w.send_fault_ticks),
                 static_cast<double>(std::min(w.send_hold_ticks, 60)), 60},
                {"watchdogs", "delay_hold_s", w.delay_hold_s, 0.05, 0.5},
                {"press", "excess_s", p.excess_s, 0.01, 1},
                {"press", "payload_kg", p.payload_kg, 0, 5},
                {"press", "blocked_error", p.blocked_error, 0.01, 0.35},
                {"press", "blocked_s", p.blocked_s, 0.1, 3},
                {"press", "blocked_travel", p.blocked_travel, 0.001, 0.1}};
  for (const auto& [section, name, value, least, most] : ranges) {
    if (value >= least && value <= most) continue;
    if (value > 0 && std::count(given_up.begin(), given_up.end(), name) > 0) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        "control.", section, ".", name, " is ", value, ", must be ", least, " to ", most,
        ": beyond that it guards nothing; --without ", name, " gives the guard up"));
  }
  for (const std::string& name : given_up) {
    const bool known = std::any_of(std::begin(ranges), std::end(ranges),
                                   [&](const auto& range) { return name == range.name; });
    if (!known)
      return absl::InvalidArgumentError(
          absl::StrCat("--without ", name, ": no guard has this name"));
  }
  return absl::OkStatus();
}

absl::Status CheckControlOptions(const ControlOptions& o, int joints) {
  const auto invalid = [](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  if (!(o.rate_hz >= 5 && o.rate_hz <= 200))
    return invalid("control.rate_hz is ", o.rate_hz, ", must be 5 to 200 ticks a second");
  if (o.player.execute_steps < 1 || o.player.late_steps < 0 ||
      o.player.execute_steps + o.player.late_steps > ArmChunk::kMaxRows) {
    return invalid("player.execute_steps is ", o.player.execute_steps, " and player.late_steps ",
                   o.player.late_steps, "; they must be at least 1 and 0, and together at most ",
                   ArmChunk::kMaxRows);
  }
  if (o.player.fade_steps < 0 || o.player.fade_steps > ArmChunk::kMaxRows)
    return invalid("player.fade_steps is ", o.player.fade_steps, ", must be 0..64");
  if (o.player.rtc_rows < 0 || o.player.rtc_rows > ArmChunk::kMaxRows)
    return invalid("player.rtc_rows is ", o.player.rtc_rows, ", must be 0..64");
  const DisturbanceObserverOptions& dob = o.disturbance_observer;
  if (!(dob.bandwidth > 0 && dob.max_correction > 0 && dob.min_dt_s > 0 &&
        dob.max_dt_s >= dob.min_dt_s && std::isfinite(dob.bandwidth + dob.max_dt_s))) {
    return invalid("disturbance_observer: bandwidth ", dob.bandwidth, ", max_correction ",
                   dob.max_correction, ", min_dt_s ", dob.min_dt_s, ", max_dt_s ", dob.max_dt_s,
                   "; all must be positive and max_dt_s at least min_dt_s");
  }
  if (!(o.smoothing >= 0 && o.smoothing <= 0.99))
    return invalid("smoothing is ", o.smoothing, ", must be 0..0.99");
  if (const absl::Status response = dob.response.Check(joints); !response.ok())
    return invalid("disturbance_observer.", response.message());
  const WatchdogOptions& w = o.watchdogs;
  if (!(w.arm_hold_s > 0 && w.arm_fault_s >= w.arm_hold_s))
    return invalid("watchdogs.arm_hold_s is ", w.arm_hold_s, " and arm_fault_s ", w.arm_fault_s,
                   "; both must be positive and the fault not before the hold");
  return CheckPress(o.press, joints);
}

}  // namespace robostress
