#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/launch/launcher.h"
#include "eval/plan/plan.h"

namespace robostress {

// What happened to the units of this call.
struct SweepOutcome {
  int completed = 0;                // units finished by this call
  int already_done = 0;             // had DONE before
  std::vector<std::string> failed;  // names of units, or of parts of units (WorkItem::Name)
  int signal = 0;                   // that interrupted it; 0: none
  bool submitted = false;           // handed to a scheduler: the rest is not known yet
  std::string hint;                 // what a person does next
  double wall_s = 0;
};

// Gets the units done that have no DONE yet, through the launcher that the options name; layout in
// run_directory.h. A unit that fails is reported with the end of its log and the others go on.
// FailedPrecondition when the directory holds units of the same id with another configuration
// (all are listed), or another sweep or its jobs are at work in it; Unavailable when a server does
// not start or dies, or the scheduler refuses.
absl::StatusOr<SweepOutcome> RunSweep(const SweepGrid& grid, const std::vector<PlannedUnit>& units,
                                      const LaunchOptions& options);

}  // namespace robostress
