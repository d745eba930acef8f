#include "robot_client/piper/arm_state.h"

#include "robot_client/piper/command_guard.h"

namespace robostress::piper {
namespace {

uint32_t FaultsOf(const ArmStatus& status) {
  uint32_t faults = 0;
  switch (status.code) {
    case StatusCode::kNormal:
    case StatusCode::kTeachRecord:
    case StatusCode::kTeachExecute:
    case StatusCode::kTeachPause:
      break;
    case StatusCode::kEmergencyStop:
      faults |= kFaultEmergencyStop;
      break;
    case StatusCode::kNoSolution:
    case StatusCode::kSingular:
      faults |= kFaultNoSolution;
      break;
    case StatusCode::kTargetLimit:
      faults |= kFaultTargetLimit;
      break;
    case StatusCode::kJointBus:
      faults |= kFaultJointBus;
      break;
    case StatusCode::kBrake:
      faults |= kFaultBrake;
      break;
    case StatusCode::kCollision:
      faults |= kFaultCollision;
      break;
    case StatusCode::kControllerTemperature:
    case StatusCode::kResistorTemperature:
      faults |= kFaultOverTemperature;
      break;
    case StatusCode::kTeachOverspeed:
    case StatusCode::kJointStatus:
    case StatusCode::kOther:
      faults |= kFaultOther;
      break;
  }
  if (status.joint_limit != 0) faults |= kFaultJointLimit;
  if (status.joint_bus != 0) faults |= kFaultJointBus;
  return faults;
}

uint32_t FaultsOf(const DriverStatus& driver) {
  uint32_t faults = 0;
  if (driver.bits & kUnderVoltage) faults |= kFaultUnderVoltage;
  if (driver.bits & (kMotorHot | kDriverHot)) faults |= kFaultOverTemperature;
  if (driver.bits & kOverCurrent) faults |= kFaultOverCurrent;
  if (driver.bits & kCollisionProtection) faults |= kFaultCollision;
  if (driver.bits & kDriverError) faults |= kFaultDriver;
  if (driver.bits & kStall) faults |= kFaultStall;
  return faults;
}

}  // namespace

bool ArmState::Take(const StampedFrame& received) {
  const CanFrame& frame = received.frame;
  if (IsCommand(frame)) {
    ++foreign_commands_;
    last_foreign_id_ = frame.id;
    last_foreign_ns_ = received.stamp_ns;
    return false;
  }
  ++frames_;
  if (const auto angles = DecodeJointAngles(frame)) {
    const auto sample = assembler_.Add(*angles, received.stamp_ns);
    if (!sample) return false;
    sample_ = *sample;
    ++sequence_;
    return true;
  }
  if (const auto speed = DecodeJointSpeed(frame)) {
    speeds_[speed->joint] = *speed;
  } else if (const auto driver = DecodeDriverStatus(frame)) {
    drivers_[driver->joint] = Driver{*driver, received.stamp_ns};
  } else if (const auto status = DecodeArmStatus(frame)) {
    status_ = *status;
    status_stamp_ns_ = received.stamp_ns;
  } else if (const auto gripper = DecodeGripperStatus(frame)) {
    gripper_ = *gripper;
  } else if (const auto limit = DecodeJointLimit(frame)) {
    limits_[limit->joint] = *limit;
  } else if (const auto acceleration = DecodeJointAcceleration(frame)) {
    accelerations_[acceleration->joint] = *acceleration;
  } else if (const auto range = DecodeGripperRange(frame)) {
    gripper_range_ = *range;
  } else if (const auto levels = DecodeCollisionLevels(frame)) {
    collision_levels_ = *levels;
  } else if (const auto text = DecodeFirmwareText(frame)) {
    if (firmware_text_.size() + text->size() <= kFirmwareText) firmware_text_ += *text;
  }
  return false;
}

void ArmState::ForgetLimits() {
  limits_.fill(std::nullopt);
  accelerations_.fill(std::nullopt);
  gripper_range_.reset();
}

uint32_t ArmState::Faults() const {
  uint32_t faults = 0;
  if (foreign_commands_ > 0) faults |= kFaultForeignCommand;
  if (status_) faults |= FaultsOf(*status_);
  for (const std::optional<Driver>& driver : drivers_) {
    if (driver) faults |= FaultsOf(driver->status);
  }
  if (gripper_ && gripper_->errors != 0) faults |= kFaultGripper;
  return faults;
}

uint8_t ArmState::FaultJoints() const {
  uint8_t joints = status_ ? status_->joint_limit | status_->joint_bus : 0;
  for (int j = 0; j < kJoints; ++j) {
    if (drivers_[j] && FaultsOf(drivers_[j]->status) != 0) joints |= 1 << j;
  }
  return joints;
}

ArmSnapshot ArmState::Snapshot(int64_t now_ns) const {
  ArmSnapshot snapshot;
  snapshot.sequence = sequence_;
  snapshot.stamp_ns = sample_.stamp_ns;
  snapshot.enabled = true;
  for (int j = 0; j < kJoints; ++j) {
    snapshot.position[j] = sample_.q[j];
    snapshot.velocity[j] = speeds_[j].velocity;
    snapshot.effort[j] = speeds_[j].current * torque_per_ampere_[j];
    snapshot.enabled = snapshot.enabled && drivers_[j].has_value() &&
                       (drivers_[j]->status.bits & kEnabled) != 0 &&
                       now_ns - drivers_[j]->stamp_ns <= kDriverAge_ns;
  }
  if (gripper_) {
    snapshot.position[kJoints] = gripper_->opening;
    snapshot.effort[kJoints] = gripper_->effort;
  }
  snapshot.has_effort = true;
  snapshot.taught = status_ && status_->control == ControlMode::kTeach;
  snapshot.faults = Faults();
  snapshot.fault_joints = FaultJoints();
  return snapshot;
}

}  // namespace robostress::piper
