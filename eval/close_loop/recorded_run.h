#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "calibration/data/sim_recordings.h"
#include "eval/launch/merged_sweep.h"

namespace robostress {

// What is recorded of an arm, and how its logs are calibrated.
struct RecordingOptions {
  std::string suite = "tabletop_goal";
  std::vector<int> tasks = {0, 1, 3};  // the last is the transfer regime
  int episodes = 6;                    // of each task, from the dev split (40 ...)
  int severity = 5;                    // of the scenario that the arm has
  int workers = 2;
  double rate_hz = 250;
  int surrogates = 999;
  uint64_t seed = 0;  // of encoder noise and surrogates
};

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
