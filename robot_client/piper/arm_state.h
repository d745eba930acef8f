#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>

#include "robot_client/can/can_frame.h"
#include "robot_client/piper/joint_assembler.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/robot_arm.h"

namespace robostress::piper {

// What an arm has said so far, frame by frame. Nothing here allocates after construction.
class ArmState {
 public:
  explicit ArmState(int64_t max_skew_ns) : assembler_(max_skew_ns) {
    firmware_text_.reserve(kFirmwareText);
  }

  // True when the frame completed a joint sample.
  bool Take(const StampedFrame& received);

  // The newest complete sample, with what is known now of velocities, efforts, drivers and faults.
  // A driver counts as enabled while its last report is at most kDriverAge_ns old.
  static constexpr int64_t kDriverAge_ns = 200'000'000;
  ArmSnapshot Snapshot(int64_t now_ns) const;

  // Torque over current [Nm/A], see firmware.h.
  void SetTorquePerAmpere(const JointVector& torque_per_ampere) {
    torque_per_ampere_ = torque_per_ampere;
  }
  void ForgetFirmware() { firmware_text_.clear(); }
  const std::string& firmware_text() const { return firmware_text_; }
  void ForgetLimits();
  void ForgetForeignCommands() { foreign_commands_ = 0; }
  void ForgetCollisionLevels() { collision_levels_.reset(); }
  const std::optional<std::array<int, kJoints>>& collision_levels() const {
    return collision_levels_;
  }
  // When the last status that this client understands came; 0: none.
  int64_t status_stamp_ns() const { return status_stamp_ns_; }
  int64_t last_foreign_ns() const { return last_foreign_ns_; }
  const std::array<std::optional<JointLimit>, kJoints>& joint_limits() const { return limits_; }
  const std::array<std::optional<JointAcceleration>, kJoints>& accelerations() const {
    return accelerations_;
  }
  const std::optional<double>& gripper_range() const { return gripper_range_; }  // [m]
  const std::optional<ArmStatus>& status() const { return status_; }
  const std::optional<GripperStatus>& gripper() const { return gripper_; }
  uint64_t torn_samples() const { return assembler_.torn(); }
  uint64_t foreign_commands() const { return foreign_commands_; }
  uint16_t last_foreign_id() const { return last_foreign_id_; }
  uint64_t frames() const { return frames_; }  // that an arm sends

 private:
  uint32_t Faults() const;
  uint8_t FaultJoints() const;

  struct Driver {
    DriverStatus status;
    int64_t stamp_ns;
  };
  JointAssembler assembler_;
  uint64_t sequence_ = 0;
  JointAssembler::Sample sample_{};
  std::array<JointSpeed, kJoints> speeds_{};
  std::array<std::optional<Driver>, kJoints> drivers_;
  std::array<std::optional<JointLimit>, kJoints> limits_;
  std::array<std::optional<JointAcceleration>, kJoints> accelerations_;
  std::optional<ArmStatus> status_;
  int64_t status_stamp_ns_ = 0, last_foreign_ns_ = 0;
  std::optional<std::array<int, kJoints>> collision_levels_;
  std::optional<GripperStatus> gripper_;
  std::optional<double> gripper_range_;
  JointVector torque_per_ampere_{};
  std::string firmware_text_;  // its storage is reserved at construction
  uint64_t foreign_commands_ = 0, frames_ = 0;
  uint16_t last_foreign_id_ = 0;

  static constexpr size_t kFirmwareText = 256;  // kept at most
};

}  // namespace robostress::piper
