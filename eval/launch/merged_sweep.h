#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/launch/sweep_runner.h"
#include "eval/plan/plan.h"
#include "eval/store/run_store.h"

namespace robostress {

struct MergedSweep {
  SweepOutcome outcome;
  std::optional<RunData> run;  // what is finished; absent when nothing is, or when interrupted or
                               // submitted
};

// RunSweep, then environment.json (when this call ran something) and the merged tables. Says on
// standard error, as `command`, what was done before and what failed.
absl::StatusOr<MergedSweep> RunAndMerge(const std::string& command, const SweepGrid& grid,
                                        const std::vector<PlannedUnit>& units,
                                        const LaunchOptions& launch);

// Says on standard error how much `units` are, as `command`.
void AnnouncePlan(const std::string& command, const std::vector<PlannedUnit>& units,
                  const LaunchOptions& launch);

// What --dry-run prints: units with their cost on standard output, the sum and what is done on
// standard error. Returns the exit code; 1 when a run would be refused.
int PrintPlan(const SweepGrid& grid, const std::vector<PlannedUnit>& units,
              const LaunchOptions& launch);

// Of a sweep's programs: 0 all units done or handed to a scheduler, 1 a unit failed, 128 + signal
// interrupted.
int ExitCodeOf(const SweepOutcome& outcome);

}  // namespace robostress
