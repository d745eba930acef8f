#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "common/unit_config.h"
#include "sim_worker/sim_task.h"

namespace robostress {

// One task of LIBERO's suites (libero_spatial, libero_object, libero_goal, libero_10), composed
// from the user's own LIBERO and robosuite checkouts: unit.libero_root / unit.robosuite_root, or
// the environment variables LIBERO_ROOT / ROBOSUITE_ROOT. Nothing of theirs is executed; visual
// files that are absent are announced once and replaced. `task` is the index in the benchmark's
// order.
absl::StatusOr<std::unique_ptr<SimTask>> MakeLiberoTask(const UnitConfig& unit, int task);

}  // namespace robostress
