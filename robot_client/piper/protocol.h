#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "robot_client/can/can_frame.h"

// The Piper's CAN protocol V2 as its public SDK writes and reads it (github.com/agilexrobotics/
// piper_sdk, version 0.6.1, protocol/protocol_v2 and piper_msgs/msg_v2): pure functions between
// frames and structures in SI units. Every frame has eight bytes, integers are big-endian. Vendor
// units appear in these two files and nowhere else. An Encode saturates what does not fit its
// field; a Decode returns nothing for another identifier, another length or an index out of range.
namespace robostress::piper {

inline constexpr int kJoints = 6;
inline constexpr int kAxes = kJoints + 1;  // the gripper is the last
using JointVector = std::array<double, kJoints>;

// Identifiers. Of a family, the first; joint or pair i has first + i.
enum Id : uint16_t {
  // to the arm
  kStopControl = 0x150,        // StopControl
  kModeControl = 0x151,        // ModeControl
  kJointTargets = 0x155,       // 3 frames, two joints each
  kGripperTarget = 0x159,      // GripperTarget
  kMitTargets = 0x15A,         // 6 frames; torque mode, not used here
  kLastCommand = 0x15F,        // of the motion commands
  kLeaderFollower = 0x470,     // configuration write
  kMotorPower = 0x471,         // MotorPower
  kLimitQuery = 0x472,         // LimitQuery
  kLimitWrite = 0x474,         // configuration write
  kJointConfig = 0x475,        // configuration write (zero, acceleration)
  kParameterQuery = 0x477,     // a query in byte 0, configuration writes in the others
  kEndVelocityWrite = 0x479,   // configuration write
  kCollisionWrite = 0x47A,     // configuration write
  kGripperRangeWrite = 0x47D,  // configuration write
  // from the arm
  kJointSpeed = 0x251,         // 6 frames, JointSpeed
  kDriver = 0x261,             // 6 frames, DriverStatus
  kArmStatus = 0x2A1,          // ArmStatus
  kEndPose = 0x2A2,            // 3 frames, two coordinates each
  kJointAngles = 0x2A5,        // 3 frames, two joints each
  kGripper = 0x2A8,            // GripperStatus
  kJointLimit = 0x473,         // JointLimit, the answer to LimitQuery 1
  kWriteReply = 0x476,         // WriteReply
  kEndVelocity = 0x478,        // the answer to ParameterQuery 1
  kCollisionLevel = 0x47B,     // the answer to ParameterQuery 2
  kJointAcceleration = 0x47C,  // JointAcceleration, the answer to LimitQuery 2
  kGripperRange = 0x47E,       // the answer to ParameterQuery 4
  // both ways
  kFirmware = 0x4AF,  // query; answer: text in several frames
};

// 0x150. Both stops end in an arm that no longer holds its pose.
enum class Stop : uint8_t {
  kNone = 0,
  kQuick = 1,  // brakes; damped, the arm sinks
  kReset = 2,  // clears every error and takes power off the joints: the arm FALLS
};
CanFrame EncodeStop(Stop stop);
std::optional<Stop> DecodeStop(const CanFrame& frame);  // nothing for teaching and trajectories too

enum class ControlMode : uint8_t {
  kStandby = 0,
  kCan = 1,
  kTeach = 2,
  kEthernet = 3,
  kWifi = 4,
  kRemote = 5,
  kLinkedTeach = 6,
  kOffline = 7,
};
enum class MoveMode : uint8_t { kP = 0, kJ = 1, kL = 2, kC = 3, kM = 4, kCpv = 5 };
enum class Follow : uint8_t {
  kPlanned = 0x00,  // each target is approached with a planned velocity profile
  kDirect = 0xAD,   // targets go to the joints' impedance controllers as they are
  kInvalid = 0xFF,
};

// 0x151. How targets are to be read.
struct ModeControl {
  ControlMode control = ControlMode::kStandby;
  MoveMode move = MoveMode::kJ;
  int speed_percent = 0;  // of the joints' maximal speed, 0 .. 100
  Follow follow = Follow::kPlanned;
};
CanFrame Encode(const ModeControl& mode);
std::optional<ModeControl> DecodeModeControl(const CanFrame& frame);

// 0x155 .. 0x157. Absolute targets [rad], resolution 0.001 degrees. pair: 0 .. 2, joints 2 pair and
// 2 pair + 1.
struct JointPair {
  int pair = 0;
  double first = 0, second = 0;  // [rad]
};
CanFrame EncodeJointTargets(const JointPair& targets);
std::optional<JointPair> DecodeJointTargets(const CanFrame& frame);
// The target [rad] as the arm will read it.
double RoundToWire(double angle);

// 0x159.
struct GripperTarget {
  double opening = 0;  // between the fingers [m], resolution 1 um
  double effort = 0;   // [Nm], 0 .. 5
  bool enable = true;
  bool clear_error = false;
  bool set_zero = false;  // configuration write
};
CanFrame Encode(const GripperTarget& target);
std::optional<GripperTarget> DecodeGripperTarget(const CanFrame& frame);

// 0x471. Motor 1 .. 6; 7 is every joint and the gripper.
inline constexpr int kAllMotors = 7;
struct MotorPower {
  int motor = kAllMotors;
  bool enable = false;
};
CanFrame Encode(const MotorPower& power);
std::optional<MotorPower> DecodeMotorPower(const CanFrame& frame);

// 0x472.
struct LimitQuery {
  int motor = 1;              // 1 .. 6
  bool acceleration = false;  // false: kJointLimit answers, true: kJointAcceleration
};
CanFrame Encode(const LimitQuery& query);
std::optional<LimitQuery> DecodeLimitQuery(const CanFrame& frame);

// 0x477 with nothing but a query: 1 kEndVelocity, 2 kCollisionLevel, 4 kGripperRange.
inline constexpr int kCollisionLevelQuery = 2, kGripperRangeQuery = 4;
CanFrame EncodeParameterQuery(int query);
std::optional<int> DecodeParameterQuery(const CanFrame& frame);

CanFrame EncodeFirmwareQuery();
bool IsFirmwareQuery(const CanFrame& frame);

// 0x2A1. A code or a mode that is not in these lists is no status that can be understood.
enum class StatusCode : uint8_t {
  kNormal = 0,
  kEmergencyStop = 1,
  kNoSolution = 2,
  kSingular = 3,
  kTargetLimit = 4,
  kJointBus = 5,
  kBrake = 6,
  kCollision = 7,
  kTeachOverspeed = 8,
  kJointStatus = 9,
  kOther = 10,
  kTeachRecord = 11,
  kTeachExecute = 12,
  kTeachPause = 13,
  kControllerTemperature = 14,
  kResistorTemperature = 15,
};
struct ArmStatus {
  ControlMode control = ControlMode::kStandby;
  StatusCode code = StatusCode::kNormal;
  MoveMode move = MoveMode::kP;
  uint8_t teach = 0;
  bool moving = false;  // the target is not reached yet
  uint8_t trajectory_point = 0;
  uint8_t joint_limit = 0;  // bit j: joint j + 1 stands at its angle limit
  uint8_t joint_bus = 0;    // bit j: joint j + 1 does not answer
};
CanFrame Encode(const ArmStatus& status);
std::optional<ArmStatus> DecodeArmStatus(const CanFrame& frame);

// 0x2A2 .. 0x2A4: the tool's pose in the base frame: position [m], roll pitch yaw about fixed axes
// x, y, z [rad]. pair 0: x, y; 1: z, roll; 2: pitch, yaw.
CanFrame EncodeEndPose(int pair, double first, double second);
std::optional<JointPair> DecodeEndPose(const CanFrame& frame);  // units as above

// 0x2A5 .. 0x2A7 [rad].
CanFrame EncodeJointAngles(const JointPair& angles);
std::optional<JointPair> DecodeJointAngles(const CanFrame& frame);

// 0x2A8.
struct GripperStatus {
  double opening = 0;  // [m]
  double effort = 0;   // [Nm]
  bool enabled = false;
  bool homed = false;
  uint8_t errors =
      0;  // bits 0 .. 5: undervoltage, motor hot, overcurrent, driver hot, sensor, driver
};
CanFrame Encode(const GripperStatus& status);
std::optional<GripperStatus> DecodeGripperStatus(const CanFrame& frame);

// 0x251 .. 0x256. The torque follows from the current by the SDK's constants: 1.18125 Nm/A at
// joints 1 to 3, 0.95844 Nm/A at 4 to 6; firmware up to S-V1.8-2 reports a quarter of the current
// of joints 1 to 3 (the SDK's Q&A, 3.2), which the caller corrects.
struct JointSpeed {
  int joint = 0;        // 0 .. 5
  double velocity = 0;  // [rad/s]
  double current = 0;   // [A]
};
CanFrame Encode(const JointSpeed& speed);
std::optional<JointSpeed> DecodeJointSpeed(const CanFrame& frame);
double TorquePerAmpere(int joint);  // [Nm/A]

// 0x261 .. 0x266.
enum DriverBit : uint8_t {
  kUnderVoltage = 1 << 0,
  kMotorHot = 1 << 1,
  kOverCurrent = 1 << 2,
  kDriverHot = 1 << 3,
  kCollisionProtection = 1 << 4,
  kDriverError = 1 << 5,
  kEnabled = 1 << 6,
  kStall = 1 << 7,
};
struct DriverStatus {
  int joint = 0;  // 0 .. 5
  double supply_V = 0;
  double driver_temperature = 0;  // [degrees C]
  double motor_temperature = 0;   // [degrees C]
  uint8_t bits = 0;               // DriverBit
  double bus_current = 0;         // [A]
};
CanFrame Encode(const DriverStatus& status);
std::optional<DriverStatus> DecodeDriverStatus(const CanFrame& frame);

// 0x473. The speed's unit is 0.01 rad/s (the vendor in piper_sdk issue 122; the SDK's own comment,
// 0.001, is wrong).
struct JointLimit {
  int joint = 0;                // 0 .. 5
  double lower = 0, upper = 0;  // [rad], resolution 0.1 degrees
  double max_speed = 0;         // [rad/s]
};
CanFrame Encode(const JointLimit& limit);
std::optional<JointLimit> DecodeJointLimit(const CanFrame& frame);

// 0x47C. Unit 0.01 rad/s^2 as in the write that sets it (0x475): an arm as delivered answers 500,
// 5 rad/s^2.
struct JointAcceleration {
  int joint = 0;
  double max_acceleration = 0;  // [rad/s^2]
};
CanFrame Encode(const JointAcceleration& acceleration);
std::optional<JointAcceleration> DecodeJointAcceleration(const CanFrame& frame);

// 0x47B, and 0x47A that writes it: the sensitivity of each joint's collision protection, 0 (off) to
// 8 in bytes 0 to 5.
inline constexpr int kMostCollisionLevel = 8;
CanFrame EncodeCollisionWrite(const std::array<int, kJoints>& levels);
std::optional<std::array<int, kJoints>> DecodeCollisionWrite(const CanFrame& frame);
CanFrame EncodeCollisionLevels(const std::array<int, kJoints>& levels);
std::optional<std::array<int, kJoints>> DecodeCollisionLevels(const CanFrame& frame);

// 0x47E: the widest opening that the gripper is configured for [m]: 0.07 or 0.1; 0 when it never
// was, and then 0x2A8 reports no opening (the SDK's Q&A, 1).
CanFrame EncodeGripperRange(double opening);
std::optional<double> DecodeGripperRange(const CanFrame& frame);

// 0x476: the arm took a write of this identifier's low byte.
CanFrame EncodeWriteReply(uint16_t written_id, bool zero_set);

// The eight bytes of text of one firmware answer; nothing for a query.
std::optional<std::string_view> DecodeFirmwareText(const CanFrame& frame);
CanFrame EncodeFirmwareText(std::string_view eight_bytes);

}  // namespace robostress::piper
