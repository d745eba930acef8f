#pragma once

#include <vector>

#include "calibration/model/effect_chain.h"
#include "calibration/model/joint_model.h"

namespace robostress::calibration {

struct JointTrack;  // joint_simulation.h

// What comes out of the command stage of `chain` at every one of `steps` to a row [rows * steps]:
// the servo's command, or the torque that was logged, and of a transmission the motor's angle
// [rad].
std::vector<double> ArrivingCommands(const JointTrack& track, const JointModel& model,
                                     EffectChain& chain, int steps);

}  // namespace robostress::calibration
