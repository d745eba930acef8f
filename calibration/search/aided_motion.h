#pragma once

#include <vector>

#include "absl/status/status.h"
#include "calibration/model/joint_simulation.h"

namespace robostress::calibration {

// Motion of a joint along a log: its model's free runs of kAidedRun seconds, each from the start
// that fits best, and what the readings say beyond them, smoothed. Where the model is right little
// is left to smooth, so accelerations follow the torque instead of the readings' noise; where it
// is not, what is left is smoothed as the readings themselves would be. Inputs position_target and
// torque.
constexpr double kAidedRun = 0.5;  // [s]
JointMotion AidedMotion(const JointTrack& track, const JointModel& model);

// Lets every log's motions of an arm's driven joints be those that their declared models aid, after
// a fit of what the rig lets free. Joints whose velocity was logged stay as they are: its
// derivative is better than a model that lacks something.
absl::Status AidArmMotions(const Rig& rig, const Plant& plant, std::vector<MeasuredLog>& logs);

}  // namespace robostress::calibration
