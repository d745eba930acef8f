#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/unit_config.h"
#include "sim_worker/sim_task.h"

namespace robostress {

// One task of LIBERO's suites (libero_spatial, libero_object, libero_goal, libero_10) or of the
// folder unit.libero_tasks, composed from the user's own files of LIBERO and robosuite
// (FindLibero). Nothing of theirs is executed; visual files that are absent are announced once and
// replaced. `task` is the index in the benchmark's order, in a folder in that of the names.
absl::StatusOr<std::unique_ptr<SimTask>> MakeLiberoTask(const UnitConfig& unit, int task);

// Whether the checkouts that the unit's suite reads are found.
absl::Status CheckLiberoFound(const UnitConfig& unit);

// Whether the files of all of unit.tasks can be read, place every fixture and hold the initial
// states that the unit starts from; in a folder of tasks, or with a table of fixtures, also whether
// each but the first, which is made next, composes: what can be said before anything is played.
absl::Status CheckLiberoTasks(const UnitConfig& unit);

// How many initial states are stored for a task.
absl::StatusOr<int> CountInitialStates(const UnitConfig& unit, int task);

// The tasks of unit.suite in order: names of files and instructions. LIBERO's own suites need no
// file for it; a folder's task whose BDDL file cannot be read has the reason and no instruction.
struct LiberoTaskLine {
  std::string name, instruction;
  absl::Status read;
};
absl::StatusOr<std::vector<LiberoTaskLine>> LiberoTaskLines(const UnitConfig& unit);

}  // namespace robostress
