#pragma once

#include <vector>

#include "absl/status/status.h"
#include "calibration/data/rig.h"
#include "calibration/model/plant.h"

namespace robostress::calibration {

// Where logs draw lines between commands that may have held (JointRecord::stepped_command), gives
// each joint the commands with which the declared model, fitted, predicts its fit logs better, and
// notes which. A shift of the command by up to a step is free in both, so that a delay does not
// decide; of two that do as well, the one that needs none beyond its row.
absl::Status ChooseCommandShapes(const Rig& rig, const Plant& plant,
                                 std::vector<MeasuredLog>& logs);

}  // namespace robostress::calibration
