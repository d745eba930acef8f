#include "robot_client/piper/protocol.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace robostress::piper {
namespace {

// Vendor units per SI unit.
constexpr double kMilliDegrees = 180'000 / M_PI;  // 0.001 degrees
constexpr double kDeciDegrees = 1'800 / M_PI;     // 0.1 degrees
constexpr double kMicrometres = 1e6;              // 0.001 mm
constexpr double kMilli = 1e3;
constexpr double kCenti = 1e2;
constexpr double kDeci = 10;

CanFrame Frame(int id) {
  CanFrame frame;
  frame.id = static_cast<uint16_t>(id);
  return frame;
}

bool Is(const CanFrame& frame, uint16_t id) { return frame.id == id && frame.size == 8; }
// Position in a family of frames, or nothing.
std::optional<int> IndexIn(const CanFrame& frame, uint16_t first, int count) {
  if (frame.size != 8 || frame.id < first || frame.id >= first + count) return std::nullopt;
  return frame.id - first;
}

// `value` in vendor units, rounded, saturated to T; not a number becomes zero.
template <class T>
T Saturate(double value) {
  if (std::isnan(value)) return 0;
  const double lowest = std::numeric_limits<T>::min(), highest = std::numeric_limits<T>::max();
  return static_cast<T>(std::clamp(std::round(value), lowest, highest));
}
template <class T>
void Put(CanFrame& frame, int byte, double value) {
  const auto bits = static_cast<std::make_unsigned_t<T>>(Saturate<T>(value));
  for (size_t i = 0; i < sizeof(T); ++i)
    frame.data[byte + i] = static_cast<uint8_t>(bits >> (8 * (sizeof(T) - 1 - i)));
}
template <class T>
double Get(const CanFrame& frame, int byte) {
  std::make_unsigned_t<T> bits = 0;
  for (size_t i = 0; i < sizeof(T); ++i)
    bits = static_cast<std::make_unsigned_t<T>>(bits << 8 | frame.data[byte + i]);
  return static_cast<T>(bits);
}

CanFrame PutPair(int id, double first, double second, double first_unit, double second_unit) {
  CanFrame frame = Frame(id);
  Put<int32_t>(frame, 0, first * first_unit);
  Put<int32_t>(frame, 4, second * second_unit);
  return frame;
}
std::optional<JointPair> GetAngles(const CanFrame& frame, uint16_t first_id) {
  const std::optional<int> pair = IndexIn(frame, first_id, 3);
  if (!pair) return std::nullopt;
  return JointPair{*pair, Get<int32_t>(frame, 0) / kMilliDegrees,
                   Get<int32_t>(frame, 4) / kMilliDegrees};
}
// Units of the end pose's frame.
double PoseUnit(int pair, int which) {
  return pair == 0 || (pair == 1 && which == 0) ? kMicrometres : kMilliDegrees;
}

// A motor's number in byte 0, as an index.
std::optional<int> MotorIndex(const CanFrame& frame) {
  const int motor = frame.data[0];
  if (motor < 1 || motor > kJoints) return std::nullopt;
  return motor - 1;
}
uint8_t Byte(int value) { return static_cast<uint8_t>(value); }

}  // namespace

CanFrame EncodeStop(Stop stop) {
  CanFrame frame = Frame(kStopControl);
  frame.data[0] = static_cast<uint8_t>(stop);
  return frame;
}

std::optional<Stop> DecodeStop(const CanFrame& frame) {
  if (!Is(frame, kStopControl) || frame.data[0] > 2) return std::nullopt;
  if (frame.data[0] == 0 && (frame.data[1] != 0 || frame.data[2] != 0)) return std::nullopt;
  return static_cast<Stop>(frame.data[0]);
}

CanFrame Encode(const ModeControl& mode) {
  CanFrame frame = Frame(kModeControl);
  frame.data[0] = static_cast<uint8_t>(mode.control);
  frame.data[1] = static_cast<uint8_t>(mode.move);
  frame.data[2] = Byte(std::clamp(mode.speed_percent, 0, 100));
  frame.data[3] = static_cast<uint8_t>(mode.follow);
  return frame;
}

std::optional<ModeControl> DecodeModeControl(const CanFrame& frame) {
  if (!Is(frame, kModeControl) || frame.data[0] > 7 || frame.data[1] > 5 || frame.data[2] > 100)
    return std::nullopt;
  return ModeControl{static_cast<ControlMode>(frame.data[0]), static_cast<MoveMode>(frame.data[1]),
                     frame.data[2], static_cast<Follow>(frame.data[3])};
}

CanFrame EncodeJointTargets(const JointPair& targets) {
  return PutPair(kJointTargets + targets.pair, targets.first, targets.second, kMilliDegrees,
                 kMilliDegrees);
}
std::optional<JointPair> DecodeJointTargets(const CanFrame& frame) {
  return GetAngles(frame, kJointTargets);
}
double RoundToWire(double angle) {
  return Saturate<int32_t>(angle * kMilliDegrees) / kMilliDegrees;
}

CanFrame Encode(const GripperTarget& target) {
  CanFrame frame = Frame(kGripperTarget);
  Put<int32_t>(frame, 0, target.opening * kMicrometres);
  Put<uint16_t>(frame, 4, std::clamp(target.effort, 0.0, 5.0) * kMilli);
  frame.data[6] = Byte((target.enable ? 1 : 0) | (target.clear_error ? 2 : 0));
  frame.data[7] = target.set_zero ? 0xAE : 0;
  return frame;
}

std::optional<GripperTarget> DecodeGripperTarget(const CanFrame& frame) {
  if (!Is(frame, kGripperTarget) || frame.data[6] > 3) return std::nullopt;
  return GripperTarget{Get<int32_t>(frame, 0) / kMicrometres, Get<uint16_t>(frame, 4) / kMilli,
                       (frame.data[6] & 1) != 0, (frame.data[6] & 2) != 0, frame.data[7] == 0xAE};
}

CanFrame Encode(const MotorPower& power) {
  CanFrame frame = Frame(kMotorPower);
  frame.data[0] = Byte(power.motor);
  frame.data[1] = power.enable ? 2 : 1;
  return frame;
}

std::optional<MotorPower> DecodeMotorPower(const CanFrame& frame) {
  if (!Is(frame, kMotorPower) || frame.data[0] < 1) return std::nullopt;
  // The SDK's comments also call 0xFF "all".
  if (frame.data[0] > kAllMotors && frame.data[0] != 0xFF) return std::nullopt;
  if (frame.data[1] != 1 && frame.data[1] != 2) return std::nullopt;
  return MotorPower{std::min<int>(frame.data[0], kAllMotors), frame.data[1] == 2};
}

CanFrame Encode(const LimitQuery& query) {
  CanFrame frame = Frame(kLimitQuery);
  frame.data[0] = Byte(query.motor);
  frame.data[1] = query.acceleration ? 2 : 1;
  return frame;
}

std::optional<LimitQuery> DecodeLimitQuery(const CanFrame& frame) {
  if (!Is(frame, kLimitQuery) || !MotorIndex(frame)) return std::nullopt;
  if (frame.data[1] != 1 && frame.data[1] != 2) return std::nullopt;
  return LimitQuery{frame.data[0], frame.data[1] == 2};
}

CanFrame EncodeParameterQuery(int query) {
  CanFrame frame = Frame(kParameterQuery);
  frame.data[0] = Byte(query);
  return frame;
}

std::optional<int> DecodeParameterQuery(const CanFrame& frame) {
  if (!Is(frame, kParameterQuery)) return std::nullopt;
  if (std::any_of(frame.data.begin() + 1, frame.data.end(), [](uint8_t b) { return b != 0; }))
    return std::nullopt;
  const int query = frame.data[0];
  if (query != 1 && query != 2 && query != 4) return std::nullopt;
  return query;
}

CanFrame EncodeFirmwareQuery() {
  CanFrame frame = Frame(kFirmware);
  frame.data[0] = 1;
  return frame;
}

bool IsFirmwareQuery(const CanFrame& frame) { return frame == EncodeFirmwareQuery(); }

CanFrame Encode(const ArmStatus& status) {
  CanFrame frame = Frame(kArmStatus);
  frame.data = {static_cast<uint8_t>(status.control),
                static_cast<uint8_t>(status.code),
                static_cast<uint8_t>(status.move),
                status.teach,
                Byte(status.moving ? 1 : 0),
                status.trajectory_point,
                status.joint_limit,
                status.joint_bus};
  return frame;
}

std::optional<ArmStatus> DecodeArmStatus(const CanFrame& frame) {
  if (!Is(frame, kArmStatus) || frame.data[0] > 7 || frame.data[1] > 15) return std::nullopt;
  ArmStatus status;
  status.control = static_cast<ControlMode>(frame.data[0]);
  status.code = static_cast<StatusCode>(frame.data[1]);
  status.move = static_cast<MoveMode>(frame.data[2]);
  status.teach = frame.data[3];
  status.moving = frame.data[4] != 0;
  status.trajectory_point = frame.data[5];
  status.joint_limit = frame.data[6] & 0x3F;
  status.joint_bus = frame.data[7] & 0x3F;
  return status;
}

CanFrame EncodeEndPose(int pair, double first, double second) {
  return PutPair(kEndPose + pair, first, second, PoseUnit(pair, 0), PoseUnit(pair, 1));
}

std::optional<JointPair> DecodeEndPose(const CanFrame& frame) {
  const std::optional<int> pair = IndexIn(frame, kEndPose, 3);
  if (!pair) return std::nullopt;
  return JointPair{*pair, Get<int32_t>(frame, 0) / PoseUnit(*pair, 0),
                   Get<int32_t>(frame, 4) / PoseUnit(*pair, 1)};
}

CanFrame EncodeJointAngles(const JointPair& angles) {
  return PutPair(kJointAngles + angles.pair, angles.first, angles.second, kMilliDegrees,
                 kMilliDegrees);
}
std::optional<JointPair> DecodeJointAngles(const CanFrame& frame) {
  return GetAngles(frame, kJointAngles);
}

CanFrame Encode(const GripperStatus& status) {
  CanFrame frame = Frame(kGripper);
  Put<int32_t>(frame, 0, status.opening * kMicrometres);
  Put<int16_t>(frame, 4, status.effort * kMilli);
  frame.data[6] =
      Byte((status.errors & 0x3F) | (status.enabled ? 1 << 6 : 0) | (status.homed ? 1 << 7 : 0));
  return frame;
}

std::optional<GripperStatus> DecodeGripperStatus(const CanFrame& frame) {
  if (!Is(frame, kGripper)) return std::nullopt;
  return GripperStatus{Get<int32_t>(frame, 0) / kMicrometres, Get<int16_t>(frame, 4) / kMilli,
                       (frame.data[6] & 1 << 6) != 0, (frame.data[6] & 1 << 7) != 0,
                       Byte(frame.data[6] & 0x3F)};
}

CanFrame Encode(const JointSpeed& speed) {
  CanFrame frame = Frame(kJointSpeed + speed.joint);
  Put<int16_t>(frame, 0, speed.velocity * kMilli);
  Put<int16_t>(frame, 2, speed.current * kMilli);
  return frame;
}

std::optional<JointSpeed> DecodeJointSpeed(const CanFrame& frame) {
  const std::optional<int> joint = IndexIn(frame, kJointSpeed, kJoints);
  if (!joint) return std::nullopt;
  return JointSpeed{*joint, Get<int16_t>(frame, 0) / kMilli, Get<int16_t>(frame, 2) / kMilli};
}

double TorquePerAmpere(int joint) { return joint < 3 ? 1.18125 : 0.95844; }

CanFrame Encode(const DriverStatus& status) {
  CanFrame frame = Frame(kDriver + status.joint);
  Put<uint16_t>(frame, 0, status.supply_V * kDeci);
  Put<int16_t>(frame, 2, status.driver_temperature);
  Put<int8_t>(frame, 4, status.motor_temperature);
  frame.data[5] = status.bits;
  Put<uint16_t>(frame, 6, status.bus_current * kMilli);
  return frame;
}

std::optional<DriverStatus> DecodeDriverStatus(const CanFrame& frame) {
  const std::optional<int> joint = IndexIn(frame, kDriver, kJoints);
  if (!joint) return std::nullopt;
  return DriverStatus{
      *joint,        Get<uint16_t>(frame, 0) / kDeci, Get<int16_t>(frame, 2), Get<int8_t>(frame, 4),
      frame.data[5], Get<uint16_t>(frame, 6) / kMilli};
}

CanFrame Encode(const JointLimit& limit) {
  CanFrame frame = Frame(kJointLimit);
  frame.data[0] = Byte(limit.joint + 1);
  Put<int16_t>(frame, 1, limit.upper * kDeciDegrees);
  Put<int16_t>(frame, 3, limit.lower * kDeciDegrees);
  Put<uint16_t>(frame, 5, limit.max_speed * kCenti);
  return frame;
}

std::optional<JointLimit> DecodeJointLimit(const CanFrame& frame) {
  if (!Is(frame, kJointLimit) || !MotorIndex(frame)) return std::nullopt;
  return JointLimit{*MotorIndex(frame), Get<int16_t>(frame, 3) / kDeciDegrees,
                    Get<int16_t>(frame, 1) / kDeciDegrees, Get<uint16_t>(frame, 5) / kCenti};
}

CanFrame Encode(const JointAcceleration& acceleration) {
  CanFrame frame = Frame(kJointAcceleration);
  frame.data[0] = Byte(acceleration.joint + 1);
  Put<uint16_t>(frame, 1, acceleration.max_acceleration * kCenti);
  return frame;
}

std::optional<JointAcceleration> DecodeJointAcceleration(const CanFrame& frame) {
  if (!Is(frame, kJointAcceleration) || !MotorIndex(frame)) return std::nullopt;
  return JointAcceleration{*MotorIndex(frame), Get<uint16_t>(frame, 1) / kCenti};
}

namespace {

CanFrame PutLevels(int id, const std::array<int, kJoints>& levels) {
  CanFrame frame = Frame(id);
  for (int j = 0; j < kJoints; ++j) Put<uint8_t>(frame, j, levels[j]);
  return frame;
}

std::optional<std::array<int, kJoints>> GetLevels(const CanFrame& frame, uint16_t id) {
  if (!Is(frame, id)) return std::nullopt;
  std::array<int, kJoints> levels;
  std::copy_n(frame.data.begin(), kJoints, levels.begin());
  return levels;
}

}  // namespace

CanFrame EncodeCollisionWrite(const std::array<int, kJoints>& levels) {
  return PutLevels(kCollisionWrite, levels);
}
std::optional<std::array<int, kJoints>> DecodeCollisionWrite(const CanFrame& frame) {
  return GetLevels(frame, kCollisionWrite);
}
CanFrame EncodeCollisionLevels(const std::array<int, kJoints>& levels) {
  return PutLevels(kCollisionLevel, levels);
}
std::optional<std::array<int, kJoints>> DecodeCollisionLevels(const CanFrame& frame) {
  return GetLevels(frame, kCollisionLevel);
}

CanFrame EncodeGripperRange(double opening) {
  CanFrame frame = Frame(kGripperRange);
  frame.data[0] = 100;  // teaching range [%], as delivered
  Put<uint8_t>(frame, 1, opening * kMilli);
  frame.data[2] = 1;  // teaching friction, as delivered
  return frame;
}

std::optional<double> DecodeGripperRange(const CanFrame& frame) {
  if (!Is(frame, kGripperRange)) return std::nullopt;
  return frame.data[1] / kMilli;
}

CanFrame EncodeWriteReply(uint16_t written_id, bool zero_set) {
  CanFrame frame = Frame(kWriteReply);
  frame.data[0] = static_cast<uint8_t>(written_id & 0xFF);
  frame.data[1] = zero_set ? 1 : 0;
  return frame;
}

std::optional<std::string_view> DecodeFirmwareText(const CanFrame& frame) {
  if (!Is(frame, kFirmware) || IsFirmwareQuery(frame)) return std::nullopt;
  return std::string_view(reinterpret_cast<const char*>(frame.data.data()), frame.data.size());
}

CanFrame EncodeFirmwareText(std::string_view eight_bytes) {
  CanFrame frame = Frame(kFirmware);
  std::copy_n(eight_bytes.begin(), std::min<size_t>(eight_bytes.size(), 8), frame.data.begin());
  return frame;
}

}  // namespace robostress::piper
