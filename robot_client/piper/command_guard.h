#pragma once

#include "absl/status/status.h"
#include "robot_client/can/can_frame.h"

namespace robostress::piper {

// Which of the frames that move or stop an arm a client may send at this moment.
enum class Consent {
  kMotion,    // targets, modes, enabling, the damped stop, queries
  kPowerOff,  // also what lets the arm fall: disabling a motor, 0x150 reset
  kSettings,  // also the sensitivity of the arm's collision protection, on a person's word
};

// The deny list, which every frame that leaves PiperArm passes: only what is listed here is sent.
// Never, whatever the consent: configuration writes (they go to the arm's flash, and the units of
// 0x474 and 0x475 are documented ten times too small: 0x470, 0x474, 0x475, 0x477 beyond a query,
// 0x479, 0x47A but for kSettings, 0x47D, 0x422, 0x121), setting the gripper's zero, teaching and
// offline trajectories, torque mode (0x15A to 0x15F, whose last torque persists when the sender
// dies), Cartesian targets, and every unknown identifier. kPermissionDenied without text: it is
// asked in the control loop.
absl::Status CheckMaySend(const CanFrame& frame, Consent consent);

// Whether a frame that somebody else sent commands or configures an arm.
bool IsCommand(const CanFrame& frame);

}  // namespace robostress::piper
