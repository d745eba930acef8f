#include "robot_client/piper/command_guard.h"

#include <algorithm>

#include "robot_client/piper/protocol.h"

namespace robostress::piper {
namespace {

bool MaySend(const CanFrame& frame, Consent consent) {
  if (const auto stop = DecodeStop(frame)) {
    return *stop == Stop::kQuick || (*stop == Stop::kReset && consent == Consent::kPowerOff);
  }
  if (const auto mode = DecodeModeControl(frame)) {
    return mode->control == ControlMode::kCan && mode->move == MoveMode::kJ &&
           (mode->follow == Follow::kPlanned || mode->follow == Follow::kDirect) &&
           frame.data[5] == 0;
  }
  if (const auto gripper = DecodeGripperTarget(frame)) {
    return frame.data[7] == 0 && (gripper->enable || consent == Consent::kPowerOff);
  }
  if (const auto power = DecodeMotorPower(frame)) {
    return power->enable || consent == Consent::kPowerOff;
  }
  if (const auto levels = DecodeCollisionWrite(frame)) {
    return consent == Consent::kSettings &&
           std::all_of(levels->begin(), levels->end(),
                       [](int level) { return level <= kMostCollisionLevel; });
  }
  return DecodeJointTargets(frame) || DecodeLimitQuery(frame) || DecodeParameterQuery(frame) ||
         IsFirmwareQuery(frame);
}

}  // namespace

absl::Status CheckMaySend(const CanFrame& frame, Consent consent) {
  return MaySend(frame, consent) ? absl::OkStatus() : absl::PermissionDeniedError("");
}

bool IsCommand(const CanFrame& frame) {
  switch (frame.id) {
    case kLeaderFollower:
    case kMotorPower:
    case kLimitWrite:
    case kJointConfig:
    case kEndVelocityWrite:
    case kCollisionWrite:
    case kGripperRangeWrite:
      return true;
    default:
      return frame.id >= kStopControl && frame.id <= kLastCommand;
  }
}

}  // namespace robostress::piper
