#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "common/unit_config.h"
#include "sim_worker/libero/catalog.h"

namespace robostress::libero {

// What a task of a suite is read from.
struct TaskFiles {
  std::string name;            // file name without ending
  std::string bddl;            // path
  std::string initial_states;  // path
  std::string instruction;
};

// Of task `task` of unit.suite: one of LIBERO's four, or the folder unit.libero_tasks, whose tasks
// are sorted by name. A folder's instructions are the :language of its BDDL files, where LIBERO-PRO
// changes them; those of LIBERO's four and of libero_90 come from the files' names, as in its
// benchmark. OutOfRange: no such task; NotFound: no initial states.
absl::StatusOr<TaskFiles> FindTaskFiles(const LiberoPaths& paths, const UnitConfig& unit, int task);

}  // namespace robostress::libero
