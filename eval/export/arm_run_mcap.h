#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"

namespace robostress {

// Whether a folder holds what robot_client recorded of an arm: ticks.csv, whole or .partial.
bool IsArmRun(const std::string& folder);

struct ArmRunSummary {
  int64_t ticks = 0, samples = 0, pictures = 0;
  int64_t pictures_missing = 0;  // named by frames.csv, and no longer there
};

// A run of robot_client as one MCAP file, as of an episode (episode_mcap.h):
//
//   topic                   type
//   /joint_states           sensor_msgs/msg/JointState  J1 .., gripper: [rad], [m], [rad/s],
//                           [Nm]; every sample of the arm, or what each tick saw where none are
//   /joints/policy, /requested, /blended, /corrected, /sent, /measured, /torque_excess
//                           robostress_msgs/msg/Joints  j1 .., gripper of a tick; nothing where
//                           it did not apply
//   /client                 robostress_msgs/msg/Client  state, cause; episode, chunk, row, lateness
//                           [us], estimated delay [s]
//   /camera/NAME            sensor_msgs/msg/CompressedImage  what the policy was shown (PNG), at
//   the
//                           time when it was; the header has the picture's own stamp. Where the
//                           client kept pictures (record_pictures)
//
// Stamps are the run's clock, the first message at 1 s. A run that was cut off is read up to there.
// The metadata record "robostress" holds config.yaml. Pictures of demonstrations are in the run's
// own data set.
// Errors name file, line, column and value.
absl::StatusOr<ArmRunSummary> WriteArmRunMcap(const std::string& folder, const std::string& path);

}  // namespace robostress
