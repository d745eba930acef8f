#pragma once

#include "absl/status/statusor.h"
#include "common/records/episode_recording.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

// The simulator's state before a control step, as LIBERO records it.
absl::StatusOr<SimulatorRow> ReadSimulator(const PandaSim& sim);

}  // namespace robostress
