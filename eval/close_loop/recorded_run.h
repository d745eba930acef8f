#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "calibration/data/sim_recordings.h"
#include "eval/launch/merged_sweep.h"

namespace robostress {

// Runs a grid to its end for `command`, whose messages say that the same command goes on.
absl::StatusOr<RunData> RunWholeGrid(const std::string& command, SweepGrid grid,
                                     const std::string& run_dir, int workers, bool record_joints);

// What a run recorded of an arm, as a rig that declares no error of it.
struct RecordedRun {
  calibration::RecordedRigSummary rig;
  std::map<std::string, JointLog> logs;  // by episode
  double contact_limit_N = 0;
};
absl::StatusOr<RecordedRun> MakeRecordedRig(const std::string& run_dir, double rate_hz,
                                            uint64_t seed, const std::string& rig_dir);

}  // namespace robostress
