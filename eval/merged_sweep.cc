#include "eval/merged_sweep.h"

#include <cstdio>

#include "common/status_macros.h"
#include "eval/environment.h"
#include "eval/process.h"
#include "eval/report.h"

namespace robostress {

void AnnouncePlan(const std::string& command, const std::vector<PlannedUnit>& units,
                  const LaunchOptions& launch) {
  int episodes = 0;
  for (const PlannedUnit& unit : units) episodes += unit.EpisodeCount();
  std::fprintf(stderr, "%s: %zu units, %d episodes, %d workers, into %s\n", command.c_str(),
               units.size(), episodes, launch.workers, launch.run_dir.c_str());
}

absl::StatusOr<MergedSweep> RunAndMerge(const std::string& command, const SweepGrid& grid,
                                        const std::vector<PlannedUnit>& units,
                                        const LaunchOptions& launch) {
  ChooseOpenMpBlas();
  MergedSweep merged;
  RS_ASSIGN_OR_RETURN(merged.outcome, RunSweep(grid, units, launch));
  const SweepOutcome& outcome = merged.outcome;
  if (outcome.already_done > 0) {
    std::fprintf(stderr, "%s: %d of %zu units were already done\n", command.c_str(),
                 outcome.already_done, units.size());
  }
  if (outcome.interrupted) return merged;
  // A call that ran nothing leaves the record of the machine that did.
  if (outcome.completed > 0) RS_RETURN_IF_ERROR(WriteEnvironment(launch.run_dir));
  if (outcome.completed + outcome.already_done > 0) {
    RS_ASSIGN_OR_RETURN(merged.run, LoadRun(launch.run_dir));
    RS_RETURN_IF_ERROR(WriteTables(*merged.run));
  }
  for (const std::string& id : outcome.failed) {
    std::fprintf(stderr, "%s: FAILED %s (%s/logs/%s.log)\n", command.c_str(), id.c_str(),
                 launch.run_dir.c_str(), id.c_str());
  }
  return merged;
}

int ExitCodeOf(const SweepOutcome& outcome) {
  if (outcome.interrupted) return 130;
  return outcome.failed.empty() ? 0 : 1;
}

int FailCommand(const std::string& command, const absl::Status& status) {
  std::fprintf(stderr, "robostress %s: %s\n", command.c_str(),
               std::string(status.message()).c_str());
  return status.code() == absl::StatusCode::kInvalidArgument ? 2 : 1;
}

}  // namespace robostress
