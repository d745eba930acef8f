#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/can/can_frame.h"
#include "robot_client/emulator/arm_firmware.h"

namespace robostress::piper {

enum class FaultKind {
  kCollision,  // collision protection: status 7, the arm freezes
  kStall,      // a stalled motor
  kMotorHot,
  kOverCurrent,
  kUnderVoltage,
  kDriverError,
  kBrake,          // status 6
  kEmergencyStop,  // as if somebody had sent 0x150 1
  kPowerOff,       // the joint's driver drops out: enable lost, the joint falls
  kJointSilent,    // a joint no longer answers the main controller
  kSilent,         // no frames at all: unplugged, or turned into a leader
  kTear,           // every second frame with J3 and J4 is lost
  kForeign,        // another sender's 0x155 frames on the bus
  kStatusSilent,   // the arm's status, 0x2A1, stops; everything else goes on
  kStatusUnknown,  // the status carries a code that no list has
  kStandby,        // the status says that the arm takes no commands
  kTeach,          // ... that it is being taught
  kLate,           // every frame of the arm comes 0.2 s late
};

// At `at_s` of the arm's time; `joint` 0 .. 5 where the kind has one; over after `for_s` where it
// can end by itself (silence, tearing, foreign frames, status, lateness), 0: never.
struct PlannedFault {
  FaultKind kind = FaultKind::kCollision;
  double at_s = 0;
  int joint = 0;
  double for_s = 0;
};

// "collision@2.5", "stall:J2@3", "silent@4+0.5" (for half a second). Errors list the kinds.
absl::StatusOr<PlannedFault> ParseFault(const std::string& text);
std::vector<std::string> FaultNames();

// Raises what is due, and filters what the arm sends.
class FaultSchedule {
 public:
  explicit FaultSchedule(std::vector<PlannedFault> faults = {}) : faults_(std::move(faults)) {}
  // At the arm's time `now_s`, once per step.
  void Apply(double now_s, ArmFirmware& firmware);
  // False for a frame that is lost on its way; may change it.
  bool Passes(CanFrame& frame);
  double late_s() const { return late_ ? 0.2 : 0; }  // of every frame
  // Whether another sender is active; it commands J1 and J2 to zero at 40 Hz.
  bool foreign_sender() const { return foreign_; }

 private:
  std::vector<PlannedFault> faults_;
  std::vector<bool> raised_, ended_;
  bool tearing_ = false, foreign_ = false, late_ = false;
  bool status_silent_ = false, status_unknown_ = false, standby_ = false, teach_ = false;
  uint64_t torn_frames_ = 0;
};

}  // namespace robostress::piper
