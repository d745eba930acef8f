#pragma once

#include "absl/status/statusor.h"
#include "sim_worker/expert_decision.h"

namespace robostress::libero {

class LiberoSimTask;

// The script for the task, closed loop on the true state: a phase per skill (reach, grasp, lift,
// carry, lower, let go; or reach, grasp, pull), which starts over when the grasp is lost. Progress
// counts the goal's parts, one whose object is held as half done. Unimplemented for goals without a
// script; the message says which have one. `task` must outlive it.
absl::StatusOr<Expert> MakeLiberoExpert(const LiberoSimTask& task);

}  // namespace robostress::libero
