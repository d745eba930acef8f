#include "robot_client/emulator/arm_settings.h"

#include <algorithm>
#include <cmath>

namespace robostress::piper {
namespace {

constexpr uint8_t kYes = 0xAE;           // marks a field as meant
constexpr uint16_t kUnchanged = 0x7FFF;  // leaves a field as it is
constexpr double kMilli = 1e3, kCenti = 1e2;

uint16_t Word(const CanFrame& frame, int byte) {
  return static_cast<uint16_t>(frame.data[byte] << 8 | frame.data[byte + 1]);
}
void PutWord(CanFrame& frame, int byte, double value) {
  const auto word = static_cast<uint16_t>(std::lround(value));
  frame.data[byte] = static_cast<uint8_t>(word >> 8);
  frame.data[byte + 1] = static_cast<uint8_t>(word & 0xFF);
}
bool IsMotor(uint8_t number) { return number >= 1 && number <= kJoints; }

}  // namespace

ArmSettings::ArmSettings(double gripper_range) : gripper_range_(gripper_range) { Restore(); }

void ArmSettings::Restore() {
  for (int j = 0; j < kJoints; ++j) {
    limits_[j] = {j, kJointRanges[j].lower, kJointRanges[j].upper, kMaxJointSpeed};
    accelerations_[j] = kMaxJointAcceleration;
  }
}

bool ArmSettings::Take(const CanFrame& frame, std::vector<CanFrame>& replies) {
  if (frame.size != 8) return false;
  switch (frame.id) {
    case kLeaderFollower:
      TakeRole(frame);
      break;
    case kLimitWrite:
      TakeLimits(frame);
      break;
    case kJointConfig:
      TakeAcceleration(frame);
      break;
    case kParameterQuery:
      TakeParameters(frame, replies);
      return true;
    case kEndVelocityWrite:
      TakeToolLimits(frame);
      break;
    case kCollisionWrite:
      for (int j = 0; j < kJoints; ++j) {
        if (frame.data[j] <= 8) collision_levels_[j] = frame.data[j];
      }
      break;
    case kGripperRangeWrite:
      teaching_range_ = frame.data[0];
      gripper_range_ = frame.data[1] / kMilli;
      teaching_friction_ = frame.data[2];
      break;
    default:
      return false;
  }
  replies.push_back(EncodeWriteReply(frame.id, false));
  return true;
}

void ArmSettings::TakeRole(const CanFrame& frame) {
  if (frame.data[0] == 0xFA) leader_ = true;
  if (frame.data[0] == 0xFC) leader_ = false;
  for (size_t i = 0; i < offsets_.size(); ++i) {
    const uint8_t offset = frame.data[i + 1];
    if (offset == 0 || offset == 0x10 || offset == 0x20) offsets_[i] = offset;
  }
}

void ArmSettings::TakeLimits(const CanFrame& frame) {
  if (!IsMotor(frame.data[0])) return;
  CanFrame as_reply = frame;
  as_reply.id = kJointLimit;
  const JointLimit written = *DecodeJointLimit(as_reply);
  JointLimit& limit = limits_[written.joint];
  if (Word(frame, 1) != kUnchanged) limit.upper = written.upper;
  if (Word(frame, 3) != kUnchanged) limit.lower = written.lower;
  if (Word(frame, 5) != kUnchanged) limit.max_speed = written.max_speed;
}

void ArmSettings::TakeAcceleration(const CanFrame& frame) {
  if (frame.data[2] != kYes || Word(frame, 3) == kUnchanged) return;
  for (int j = 0; j < kJoints; ++j) {
    if (frame.data[0] == j + 1 || frame.data[0] == kAllMotors)
      accelerations_[j] = Word(frame, 3) / kCenti;
  }
}

// A query in byte 0 and settings in the others may come together. Byte 4, the load, counts only
// after kYes in byte 3; the SDK sends 0x03 there with everything. The load changes nothing here.
void ArmSettings::TakeParameters(const CanFrame& frame, std::vector<CanFrame>& replies) {
  if (frame.data[1] == 1) tool_ = {};
  if (frame.data[1] == 2) Restore();
  if (frame.data[1] != 0 || frame.data[2] != 0 || frame.data[3] == kYes)
    replies.push_back(EncodeWriteReply(frame.id, false));
  Answer(frame.data[0], replies);
}

void ArmSettings::TakeToolLimits(const CanFrame& frame) {
  int byte = 0;
  for (double* value : {&tool_.velocity, &tool_.angular_velocity, &tool_.acceleration,
                        &tool_.angular_acceleration}) {
    if (Word(frame, byte) != kUnchanged) *value = Word(frame, byte) / kMilli;
    byte += 2;
  }
}

void ArmSettings::Answer(int query, std::vector<CanFrame>& replies) const {
  if (query == 1) {
    CanFrame reply{kEndVelocity, 8, {}};
    PutWord(reply, 0, tool_.velocity * kMilli);
    PutWord(reply, 2, tool_.angular_velocity * kMilli);
    PutWord(reply, 4, tool_.acceleration * kMilli);
    PutWord(reply, 6, tool_.angular_acceleration * kMilli);
    replies.push_back(reply);
  } else if (query == 2) {
    CanFrame reply{kCollisionLevel, 8, {}};
    std::copy(collision_levels_.begin(), collision_levels_.end(), reply.data.begin());
    replies.push_back(reply);
  } else if (query == kGripperRangeQuery) {
    CanFrame reply = EncodeGripperRange(gripper_range_);
    reply.data[0] = teaching_range_;
    reply.data[2] = teaching_friction_;
    replies.push_back(reply);
  }
}

}  // namespace robostress::piper
