#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/plan.h"
#include "eval/run_store.h"
#include "eval/sweep_runner.h"

namespace robostress {

struct MergedSweep {
  SweepOutcome outcome;
  std::optional<RunData> run;  // what is finished; absent when nothing is, or when interrupted
};

// RunSweep, then environment.json (when this call ran something) and the merged tables. Says on
// standard error, as `command`, what was done before and what failed.
absl::StatusOr<MergedSweep> RunAndMerge(const std::string& command, const SweepGrid& grid,
                                        const std::vector<PlannedUnit>& units,
                                        const LaunchOptions& launch);

// Says on standard error how much `units` are, as `command`.
void AnnouncePlan(const std::string& command, const std::vector<PlannedUnit>& units,
                  const LaunchOptions& launch);

// Of a sweep's programs: 0 all units done, 1 a unit failed, 130 interrupted.
int ExitCodeOf(const SweepOutcome& outcome);
// Prints the error as `command`; 2 when the command is wrong, else 1.
int FailCommand(const std::string& command, const absl::Status& status);

}  // namespace robostress
