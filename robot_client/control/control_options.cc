#include "robot_client/control/control_options.h"

#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

absl::Status CheckPress(const PressOptions& o, int joints) {
  const std::pair<const char*, const std::vector<double>*> vectors[] = {
      {"excess", &o.excess}, {"friction", &o.friction}, {"viscous", &o.viscous}};
  for (const auto& [name, values] : vectors) {
    if (static_cast<int>(values->size()) != joints) {
      return absl::InvalidArgumentError(absl::StrCat(
          "press.", name, " has ", values->size(), " numbers, must have one per joint: ", joints));
    }
    for (const double value : *values) {
      if (!(value >= 0 && value <= 100))
        return absl::InvalidArgumentError(
            absl::StrCat("press.", name, " holds ", value, ", must be 0 to 100"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckControlOptions(const ControlOptions& o, int joints) {
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
