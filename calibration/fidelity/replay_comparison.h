#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "sim_worker/joint_log.h"

namespace robostress::calibration {

// How far a simulation is from a recording, root mean squares over control steps.
struct ReplayError {
  double joint_rad = 0;  // over steps and joints
  double tool_m = 0;     // distance of the tool
  int steps = 0;
};

struct ReplayComparison {
  ReplayError free_motion;  // until the recording's first contact
  ReplayError whole;        // contacts included, where small differences grow
};

// Plays the recorded actions of the episodes again from their initial states, under `scenario` (a
// name or a scenario file) at the recorded severity, and compares with what was recorded. A step
// counts as free until the recorded contact force first exceeds contact_limit_N.
absl::StatusOr<ReplayComparison> CompareReplays(const std::vector<JointLog>& recorded,
                                                const std::string& scenario,
                                                double contact_limit_N);

}  // namespace robostress::calibration
