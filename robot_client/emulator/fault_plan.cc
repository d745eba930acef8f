#include "robot_client/emulator/fault_plan.h"

#include <array>
#include <cmath>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"

namespace robostress::piper {
namespace {

struct Kind {
  FaultKind kind;
  const char* name;
  bool has_joint;
};
constexpr std::array<Kind, 18> kKinds = {{{FaultKind::kCollision, "collision", true},
                                          {FaultKind::kStall, "stall", true},
                                          {FaultKind::kMotorHot, "motor-hot", true},
                                          {FaultKind::kOverCurrent, "over-current", true},
                                          {FaultKind::kUnderVoltage, "under-voltage", true},
                                          {FaultKind::kDriverError, "driver-error", true},
                                          {FaultKind::kBrake, "brake", false},
                                          {FaultKind::kEmergencyStop, "emergency-stop", false},
                                          {FaultKind::kPowerOff, "power-off", true},
                                          {FaultKind::kJointSilent, "joint-silent", true},
                                          {FaultKind::kSilent, "silent", false},
                                          {FaultKind::kTear, "tear", false},
                                          {FaultKind::kForeign, "foreign", false},
                                          {FaultKind::kStatusSilent, "status-silent", false},
                                          {FaultKind::kStatusUnknown, "status-unknown", false},
                                          {FaultKind::kStandby, "standby", false},
                                          {FaultKind::kTeach, "teach", false},
                                          {FaultKind::kLate, "late", false}}};

absl::Status Malformed(const std::string& text, const std::string& why) {
  return absl::InvalidArgumentError(absl::StrCat(
      "fault '", text, "': ", why, "; expected KIND[:J1..J6]@SECONDS[+DURATION], KIND one of ",
      absl::StrJoin(FaultNames(), ", ")));
}

bool ReadSeconds(const std::string& text, double& seconds) {
  return absl::SimpleAtod(text, &seconds) && std::isfinite(seconds) && seconds >= 0;
}

// A motor's fault freezes the arm too.
void RaiseMotor(ArmFirmware& firmware, int joint, DriverBit bit, StatusCode code) {
  firmware.RaiseDriverFault(joint, bit);
  firmware.RaiseStatus(code);
}

}  // namespace

std::vector<std::string> FaultNames() {
  std::vector<std::string> names;
  for (const Kind& kind : kKinds) names.push_back(kind.name);
  return names;
}

absl::StatusOr<PlannedFault> ParseFault(const std::string& text) {
  const std::vector<std::string> halves = absl::StrSplit(text, '@');
  if (halves.size() != 2) return Malformed(text, "there is no single '@'");
  const std::vector<std::string> what = absl::StrSplit(halves[0], ':');
  const std::vector<std::string> when = absl::StrSplit(halves[1], '+');
  const Kind* found = nullptr;
  for (const Kind& kind : kKinds) {
    if (what[0] == kind.name) found = &kind;
  }
  if (found == nullptr) return Malformed(text, absl::StrCat("kind '", what[0], "' is unknown"));
  PlannedFault fault;
  fault.kind = found->kind;
  if (what.size() > 2 || (what.size() == 2) != found->has_joint)
    return Malformed(text, absl::StrCat("kind ", what[0],
                                        found->has_joint ? " needs one joint" : " has no joint"));
  if (found->has_joint) {
    int number = 0;
    if (what[1].size() != 2 || what[1][0] != 'J' || !absl::SimpleAtoi(what[1].substr(1), &number) ||
        number < 1 || number > kJoints)
      return Malformed(text, absl::StrCat("joint '", what[1], "' is none of J1 to J6"));
    fault.joint = number - 1;
  }
  if (when.size() > 2 || !ReadSeconds(when[0], fault.at_s) ||
      (when.size() == 2 && !ReadSeconds(when[1], fault.for_s)))
    return Malformed(text,
                     absl::StrCat("time '", halves[1], "' is not SECONDS or SECONDS+DURATION"));
  return fault;
}

void FaultSchedule::Apply(double now_s, ArmFirmware& firmware) {
  raised_.resize(faults_.size());
  ended_.resize(faults_.size());
  for (size_t i = 0; i < faults_.size(); ++i) {
    const PlannedFault& fault = faults_[i];
    const bool begins = !raised_[i] && now_s >= fault.at_s;
    const bool ends = !ended_[i] && fault.for_s > 0 && now_s >= fault.at_s + fault.for_s;
    if (!begins && !ends) continue;
    raised_[i] = true;
    ended_[i] = ends;
    const bool on = !ends;
    switch (fault.kind) {
      case FaultKind::kCollision:
        if (on) RaiseMotor(firmware, fault.joint, kCollisionProtection, StatusCode::kCollision);
        break;
      case FaultKind::kStall:
        if (on)
          RaiseMotor(firmware, fault.joint, robostress::piper::kStall, StatusCode::kJointStatus);
        break;
      case FaultKind::kMotorHot:
        if (on)
          RaiseMotor(firmware, fault.joint, robostress::piper::kMotorHot, StatusCode::kJointStatus);
        break;
      case FaultKind::kOverCurrent:
        if (on)
          RaiseMotor(firmware, fault.joint, robostress::piper::kOverCurrent,
                     StatusCode::kJointStatus);
        break;
      case FaultKind::kUnderVoltage:
        if (on)
          RaiseMotor(firmware, fault.joint, robostress::piper::kUnderVoltage,
                     StatusCode::kJointStatus);
        break;
      case FaultKind::kDriverError:
        if (on)
          RaiseMotor(firmware, fault.joint, robostress::piper::kDriverError,
                     StatusCode::kJointStatus);
        break;
      case FaultKind::kBrake:
        if (on) firmware.RaiseStatus(StatusCode::kBrake);
        break;
      case FaultKind::kEmergencyStop:
        if (on) firmware.Take(EncodeStop(Stop::kQuick));
        break;
      case FaultKind::kPowerOff:
        if (on) firmware.Take(Encode(MotorPower{fault.joint + 1, false}));
        break;
      case FaultKind::kJointSilent:
        firmware.SetJointSilent(fault.joint, on);
        break;
      case FaultKind::kSilent:
        firmware.SetSilent(on);
        break;
      case FaultKind::kTear:
        tearing_ = on;
        break;
      case FaultKind::kForeign:
        foreign_ = on;
        break;
      case FaultKind::kStatusSilent:
        status_silent_ = on;
        break;
      case FaultKind::kStatusUnknown:
        status_unknown_ = on;
        break;
      case FaultKind::kStandby:
        standby_ = on;
        break;
      case FaultKind::kTeach:
        teach_ = on;
        break;
      case FaultKind::kLate:
        late_ = on;
        break;
    }
  }
}

bool FaultSchedule::Passes(CanFrame& frame) {
  if (frame.id == kArmStatus) {
    if (status_silent_) return false;
    if (status_unknown_) frame.data[1] = 0x2A;
    if (standby_) frame.data[0] = static_cast<uint8_t>(ControlMode::kStandby);
    if (teach_) frame.data[0] = static_cast<uint8_t>(ControlMode::kTeach);
  }
  if (!tearing_ || frame.id != kJointAngles + 1) return true;
  return ++torn_frames_ % 2 != 0;
}

}  // namespace robostress::piper
