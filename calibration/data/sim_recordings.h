#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "sim_worker/joint_log.h"

namespace robostress::calibration {

// The joint logs of one unit that ran with --record-joints, in the order of task and episode. `run`
// is a unit's directory, or a sweep's with one unit; `unit` picks one of several by its id. Errors
// list the units there are, or say how to record.
absl::StatusOr<std::vector<std::string>> FindJointLogs(const std::string& run,
                                                       const std::string& unit);

// Rows of `rate_hz`, which divides the recorded 500. The simulator gives the torque of a sub-step
// as a push at its start, so that half of a push belongs to the row before and half to the row
// after (its Euler steps are leapfrog steps in position): a row's torque is the trapezoidal mean
// over it.
absl::StatusOr<RecordedEpisode> EpisodeOfJointLog(const JointLog& log, double rate_hz);

// The Panda of the simulator: ComposePandaArm, joints robot0_joint1 .. 7.
RecordedArm PandaOfRecordings(const std::string& rig_name);

}  // namespace robostress::calibration
