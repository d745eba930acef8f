#include "robot_client/emulator/arm_firmware.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress::piper {
namespace {

constexpr double kStep_s = PiperPlant::kStep_s;
constexpr uint64_t kFastSteps = 5;     // 200 Hz
constexpr uint64_t kDriverSteps = 25;  // 40 Hz
constexpr size_t kMaxDelayed = 4096;  // target frames on their way; more are lost, as on a full bus

// Gains of the joints' servos [Nm/rad], [Nm s/rad] and the time constant of the integral part. The
// feedback of a Piper of firmware S-V1.8-6 stays within 0.2 degrees of its targets while J2 carries
// 3.9 A, 4.6 Nm (piper_sdk issue 119); these gains do. kDirect has fixed gains without integral
// part: those of MuJoCo Menagerie's agilex_piper.
struct Gains {
  double kp, kd;
};
constexpr std::array<Gains, kJoints> kServo = {
    {{200, 12}, {200, 12}, {200, 8}, {60, 1.2}, {60, 1.2}, {60, 1}}};
constexpr std::array<Gains, kJoints> kImpedance = {
    {{80, 5}, {80, 5}, {80, 5}, {40, 1.2}, {10, 0.8}, {10, 0.8}}};
constexpr double kIntegralTime_s = 0.3;
constexpr double kIntegralShare = 0.3;  // of the torque limit, at most
// The damped stop: the motors brake like a viscous damper and the arm sinks [Nm s/rad].
constexpr JointVector kBrake = {40, 40, 40, 8, 8, 8};

// A motor that gives this share of its largest torque for this long without moving is stalled.
constexpr double kStallTorque = 0.95, kStallTime_s = 0.5, kStallSpeed = 0.05;
// The target counts as reached when the joint is this close [rad].
constexpr double kReached = 0.01;

// Finger drive: force per commanded torque [N/Nm] and its servo [N/m], [N s/m].
constexpr double kForcePerTorque = 10;
constexpr Gains kFinger = {2000, 60};

bool IsTarget(const CanFrame& frame) {
  return DecodeJointTargets(frame) || DecodeGripperTarget(frame) || DecodePoseTarget(frame) ||
         DecodeMitTarget(frame);
}

}  // namespace

ArmFirmware::ArmFirmware(const FirmwareOptions& options) : options_(options) {
  for (int j = 0; j < kJoints; ++j) {
    limits_[j] = {j, kJointRanges[j].lower, kJointRanges[j].upper, kMaxJointSpeed};
    accelerations_[j] = kMaxJointAcceleration;
  }
}

void ArmFirmware::Take(const CanFrame& frame) {
  if (IsTarget(frame)) {
    if (delayed_.size() < kMaxDelayed) {
      const double lag_steps = std::round(options_.command_lag_s / kStep_s);
      delayed_.push_back({step_ + static_cast<uint64_t>(lag_steps), frame});
    }
  } else if (const auto stop = DecodeStop(frame)) {
    TakeStop(*stop);
  } else if (const auto mode = DecodeModeControl(frame)) {
    mode_ = *mode;
  } else if (const auto power = DecodeMotorPower(frame)) {
    TakePower(*power);
  } else if (const auto limit_query = DecodeLimitQuery(frame)) {
    TakeLimitQuery(*limit_query);
  } else if (const auto query = DecodeParameterQuery(frame)) {
    TakeParameterQuery(*query);
  } else if (IsFirmwareQuery(frame)) {
    // Text over several frames, the version in the middle of it.
    const std::string text = absl::StrCat("H-V1.2-1", FirmwareName(options_.version));
    for (size_t at = 0; at < text.size(); at += 8)
      replies_.push_back(EncodeFirmwareText(std::string_view(text).substr(at, 8)));
  } else {
    TakeWrite(frame);
  }
}

void ArmFirmware::TakeStop(Stop stop) {
  if (stop == Stop::kQuick) {
    stopped_ = true;
  } else if (stop == Stop::kReset) {
    stopped_ = false;
    latched_ = StatusCode::kNormal;
    mode_ = {};
    for (Power& power : power_) {
      power.enabled = false;
      power.deaf = 1;
      power.fault_bits = 0;
    }
    gripper_enabled_ = false;
    beyond_limit_.fill(false);
    pose_unreachable_ = false;
    mit_.fill(std::nullopt);
    delayed_.clear();
  }
}

void ArmFirmware::TakePower(const MotorPower& power) {
  for (int j = 0; j < kJoints; ++j) {
    if (power.motor != kAllMotors && power.motor != j + 1) continue;
    Power& motor = power_[j];
    if (!power.enable) {
      motor.enabled = false;
    } else if (motor.deaf > 0) {
      --motor.deaf;
    } else if (!motor.enabled && !stopped_ && motor.fault_bits == 0 && !motor.silent) {
      motor.enabled = true;
      motor.integral = 0;
      planners_[j].Reset(last_.q[j]);
    }
  }
  if (power.motor == kAllMotors) {
    if (power.enable && !gripper_enabled_) gripper_target_ = {last_.opening, 1.0, true};
    gripper_enabled_ = power.enable;
  }
}

void ArmFirmware::TakeLimitQuery(const LimitQuery& query) {
  const int joint = query.motor - 1;
  if (power_[joint].silent) return;
  replies_.push_back(query.acceleration ? Encode(JointAcceleration{joint, accelerations_[joint]})
                                        : Encode(limits_[joint]));
}

void ArmFirmware::TakeParameterQuery(int query) {
  CanFrame reply;
  if (query == 1) {
    // 0.5 m/s, 1.5 rad/s, 0.8 m/s^2, 2 rad/s^2, unit 0.001 each.
    reply = {kEndVelocity, 8, {0x01, 0xF4, 0x05, 0xDC, 0x03, 0x20, 0x07, 0xD0}};
  } else if (query == 2) {
    reply = EncodeCollisionLevels(collision_levels_);
  } else {
    reply = EncodeGripperRange(options_.gripper_range);
  }
  replies_.push_back(reply);
}

// Configuration writes that change what this model has: angle and speed limits. Others are
// acknowledged only. 0x7FFF leaves a field as it is.
void ArmFirmware::TakeWrite(const CanFrame& frame) {
  if (frame.id == kLimitWrite && frame.data[0] >= 1 && frame.data[0] <= kJoints) {
    CanFrame as_reply = frame;
    as_reply.id = kJointLimit;
    const JointLimit written = *DecodeJointLimit(as_reply);
    JointLimit& limit = limits_[written.joint];
    const auto given = [&](int byte) {
      return frame.data[byte] != 0x7F || frame.data[byte + 1] != 0xFF;
    };
    if (given(1)) limit.upper = written.upper;
    if (given(3)) limit.lower = written.lower;
    if (given(5)) limit.max_speed = written.max_speed;
    replies_.push_back(EncodeWriteReply(frame.id, false));
  } else if (const auto levels = DecodeCollisionWrite(frame)) {
    collision_levels_ = *levels;
    replies_.push_back(EncodeWriteReply(frame.id, false));
  } else if (frame.id == kJointConfig || frame.id == kEndVelocityWrite ||
             frame.id == kGripperRangeWrite || frame.id == kParameterQuery) {
    replies_.push_back(EncodeWriteReply(frame.id, false));
  }
}

void ArmFirmware::ApplyTarget(const CanFrame& frame) {
  if (const auto gripper = DecodeGripperTarget(frame)) {
    gripper_enabled_ = gripper->enable;
    gripper_target_ = *gripper;
    gripper_target_.opening = std::clamp(gripper->opening, 0.0, kGripperOpening);
  } else if (const auto pair = DecodeJointTargets(frame)) {
    ApplyJointTargets(*pair);
  } else if (const auto pose = DecodePoseTarget(frame)) {
    ApplyPoseTarget(*pose);
  } else if (const auto mit = DecodeMitTarget(frame)) {
    mit_[mit->joint] = *mit;
  }
}

// A pose counts when its last frame is there. Both move modes P and L go there joint by joint here;
// a real arm leads the tool along a line in mode L.
void ArmFirmware::ApplyPoseTarget(const JointPair& pair) {
  pose_target_[2 * pair.pair] = pair.first;
  pose_target_[2 * pair.pair + 1] = pair.second;
  const bool cartesian = mode_.move == MoveMode::kP || mode_.move == MoveMode::kL;
  if (pair.pair != 2 || mode_.control != ControlMode::kCan || !cartesian) return;
  std::array<Range, kJoints> limits;
  for (int j = 0; j < kJoints; ++j) limits[j] = {limits_[j].lower, limits_[j].upper};
  const auto q = SolvePose({pose_target_[0], pose_target_[1], pose_target_[2]},
                           {pose_target_[3], pose_target_[4], pose_target_[5]}, last_.q, limits,
                           ZeroOf(options_.version));
  pose_unreachable_ = !q.has_value();
  for (int j = 0; j < kJoints && q; ++j) planners_[j].SetTarget((*q)[j]);
}

// A target beyond a limit is not clamped: the arm reports it and no joint follows until the targets
// are within the limits again (piper_sdk issue 94).
void ArmFirmware::ApplyJointTargets(const JointPair& pair) {
  if (mode_.control != ControlMode::kCan || mode_.move != MoveMode::kJ) return;
  constexpr double kResolution = 1e-5;  // [rad], half of the wire's
  for (const auto& [joint, target] :
       {std::pair{2 * pair.pair, pair.first}, std::pair{2 * pair.pair + 1, pair.second}}) {
    beyond_limit_[joint] =
        target < limits_[joint].lower - kResolution || target > limits_[joint].upper + kResolution;
    if (!beyond_limit_[joint]) planners_[joint].SetTarget(target);
  }
}

double ArmFirmware::ServoTorque(int joint, const PlantReading& reading) {
  Power& power = power_[joint];
  if (!power.enabled) return 0;
  if (stopped_) return -kBrake[joint] * reading.dq[joint];
  if (mode_.move == MoveMode::kM && mit_[joint]) {
    const MitTarget& mit = *mit_[joint];
    power.integral = 0;
    const double torque = mit.kp * (mit.position - reading.q[joint]) +
                          mit.kd * (mit.velocity - reading.dq[joint]) +
                          CurrentScale(options_.version, joint) * mit.feedforward;
    return std::clamp(torque, -PiperPlant::kTorqueLimit[joint], PiperPlant::kTorqueLimit[joint]);
  }
  const bool direct = mode_.follow == Follow::kDirect;
  const JointPlanner& planner = planners_[joint];
  const Gains& gains = direct ? kImpedance[joint] : kServo[joint];
  const double error = planner.position() - reading.q[joint];
  if (direct) {
    power.integral = 0;
  } else {
    const double most = kIntegralShare * PiperPlant::kTorqueLimit[joint];
    power.integral =
        std::clamp(power.integral + gains.kp * error * kStep_s / kIntegralTime_s, -most, most);
  }
  const double torque = gains.kp * error + gains.kd * (planner.velocity() - reading.dq[joint]) +
                        power.integral +
                        options_.gravity_feedforward[joint] * reading.gravity[joint];
  return std::clamp(torque, -PiperPlant::kTorqueLimit[joint], PiperPlant::kTorqueLimit[joint]);
}

void ArmFirmware::WatchStall(int joint, double torque, const PlantReading& reading) {
  Power& power = power_[joint];
  const bool strained = std::abs(torque) >= kStallTorque * PiperPlant::kTorqueLimit[joint] &&
                        std::abs(reading.dq[joint]) < kStallSpeed;
  power.stalled_s = strained ? power.stalled_s + kStep_s : 0;
  if (power.stalled_s >= kStallTime_s) {
    RaiseDriverFault(joint, kStall);
    RaiseStatus(StatusCode::kJointStatus);
  }
}

double ArmFirmware::FingerForce(const PlantReading& reading) const {
  if (!gripper_enabled_) return 0;
  const double most = kForcePerTorque * gripper_target_.effort;
  const double force = kFinger.kp * 0.5 * (gripper_target_.opening - reading.opening) -
                       kFinger.kd * 0.5 * reading.opening_speed;
  return std::clamp(force, -most, most);
}

ArmFirmware::Torques ArmFirmware::Step(const PlantReading& reading) {
  last_ = reading;
  while (!delayed_.empty() && delayed_.front().due_step <= step_) {
    ApplyTarget(delayed_.front().frame);
    delayed_.pop_front();
  }
  const bool refused = std::count(beyond_limit_.begin(), beyond_limit_.end(), true) > 0;
  // A latched fault freezes the arm where it is; it holds until the reset.
  const bool frozen = refused || pose_unreachable_ || latched_ != StatusCode::kNormal;
  Torques torques;
  for (int j = 0; j < kJoints; ++j) {
    JointPlanner& planner = planners_[j];
    const bool torque_mode = mode_.move == MoveMode::kM && mit_[j].has_value();
    if (!power_[j].enabled || stopped_ || torque_mode) {
      planner.Reset(reading.q[j]);
    } else if (frozen) {
      planner.Brake(accelerations_[j], kStep_s);
    } else if (mode_.follow == Follow::kDirect) {
      planner.Jump();
    } else {
      planner.Step(limits_[j].max_speed * mode_.speed_percent / 100, accelerations_[j], kStep_s);
    }
    torques.motor[j] = ServoTorque(j, reading);
    WatchStall(j, torques.motor[j], reading);
  }
  torques.finger_force = FingerForce(reading);
  UpdateStatus(reading);
  ++step_;
  return torques;
}

void ArmFirmware::UpdateStatus(const PlantReading& reading) {
  status_.control = mode_.control;
  status_.move = mode_.move;
  status_.joint_limit = status_.joint_bus = 0;
  status_.moving = false;
  for (int j = 0; j < kJoints; ++j) {
    const auto bit = static_cast<uint8_t>(1 << j);
    if (beyond_limit_[j]) status_.joint_limit |= bit;
    if (power_[j].silent) status_.joint_bus |= bit;
    status_.moving =
        status_.moving ||
        (power_[j].enabled &&
         (!planners_[j].at_target() || std::abs(planners_[j].target() - reading.q[j]) > kReached));
  }
  if (stopped_) {
    status_.code = StatusCode::kEmergencyStop;
  } else if (latched_ != StatusCode::kNormal) {
    status_.code = latched_;
  } else if (pose_unreachable_) {
    status_.code = StatusCode::kNoSolution;
  } else if (status_.joint_bus != 0) {
    status_.code = StatusCode::kJointBus;
  } else {
    status_.code = status_.joint_limit != 0 ? StatusCode::kTargetLimit : StatusCode::kNormal;
  }
}

void ArmFirmware::TakeReports(const PlantReading& reading, std::vector<CanFrame>& frames) {
  frames.clear();
  frames.swap(replies_);
  if (step_ % kFastSteps == 0) ReportFast(reading, frames);
  if (step_ % kDriverSteps == 0) ReportDrivers(frames);
  if (silent_) frames.clear();
}

void ArmFirmware::ReportFast(const PlantReading& reading, std::vector<CanFrame>& frames) const {
  for (int j = 0; j < kJoints; ++j) {
    if (power_[j].silent) continue;
    const double current =
        reading.torque[j] / (TorquePerAmpere(j) * CurrentScale(options_.version, j));
    frames.push_back(Encode(JointSpeed{j, reading.dq[j], current}));
  }
  frames.push_back(Encode(status_));
  JointVector q;
  for (int j = 0; j < kJoints; ++j) q[j] = RoundToWire(reading.q[j]);
  const Eigen::Isometry3d T_base_tool = ToolPose(q, ZeroOf(options_.version));
  const Eigen::Vector3d p = T_base_tool.translation(), rpy = FixedAngles(T_base_tool.linear());
  frames.push_back(EncodeEndPose(0, p.x(), p.y()));
  frames.push_back(EncodeEndPose(1, p.z(), rpy[0]));
  frames.push_back(EncodeEndPose(2, rpy[1], rpy[2]));
  for (int pair = 0; pair < kJoints / 2; ++pair)
    frames.push_back(EncodeJointAngles({pair, q[2 * pair], q[2 * pair + 1]}));
  GripperStatus gripper;
  gripper.opening = reading.opening;
  gripper.effort = reading.grip_force / kForcePerTorque;
  gripper.enabled = gripper_enabled_;
  gripper.homed = true;
  frames.push_back(Encode(gripper));
}

void ArmFirmware::ReportDrivers(std::vector<CanFrame>& frames) const {
  for (int j = 0; j < kJoints; ++j) {
    if (power_[j].silent) continue;
    DriverStatus driver;
    driver.joint = j;
    driver.supply_V = 24;
    driver.driver_temperature = 35;
    driver.motor_temperature = 30;
    driver.bits = power_[j].fault_bits;
    if (power_[j].enabled) driver.bits |= kEnabled;
    driver.bus_current = 0.1;
    frames.push_back(Encode(driver));
  }
}

void ArmFirmware::RaiseDriverFault(int joint, DriverBit bit) { power_[joint].fault_bits |= bit; }

void ArmFirmware::RaiseStatus(StatusCode code) {
  if (latched_ == StatusCode::kNormal) latched_ = code;
}

void ArmFirmware::SetJointSilent(int joint, bool silent) { power_[joint].silent = silent; }

}  // namespace robostress::piper
