#include "eval/launch/merged_sweep.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "common/embedded_policies.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/launch/cost_estimate.h"
#include "eval/launch/exit_code.h"
#include "eval/launch/server_process.h"
#include "eval/plan/titles.h"
#include "eval/report/report.h"
#include "eval/store/environment.h"

namespace robostress {

int PrintPlan(const SweepGrid& grid, const std::vector<PlannedUnit>& units,
              const LaunchOptions& launch) {
  const RunDirectory run(launch.run_dir);
  const CostModel costs = CostModel::FromRun(run, units);
  const std::vector<WorkItem> items = PendingItems(run, units, launch.part_episodes);
  std::map<const PlannedUnit*, double> pending;
  double total_s = 0;
  int episodes = 0;
  for (const WorkItem& item : items) {
    const double seconds = costs.Seconds(item);
    pending[item.unit] += seconds;
    total_s += seconds;
    episodes += item.count;
  }
  for (const PlannedUnit& unit : units) {
    const auto cost = pending.find(&unit);
    std::printf("%s  %d episodes  %s\n", unit.id.c_str(), unit.EpisodeCount(),
                cost == pending.end() ? "done" : FormatDuration(cost->second).c_str());
  }
  std::fflush(stdout);  // both may go into one file
  std::fprintf(
      stderr,
      "%zu units are done, %zu are not: %zu pieces of work, %d episodes, about %s of one "
      "worker, %s on %d (%s)\n",
      units.size() - pending.size(), pending.size(), items.size(), episodes,
      FormatDuration(total_s).c_str(),
      FormatDuration(total_s / std::max(1, launch.workers)).c_str(), launch.workers,
      costs.recorded_episodes() == 0
          ? "defaults for one core; nothing comparable is recorded here"
          : absl::StrCat("from ", costs.recorded_episodes(), " recorded episodes").c_str());
  // What a run would refuse, before anything is spent on it.
  std::error_code error;
  if (!std::filesystem::exists(launch.run_dir + "/plan", error)) return kExitDone;
  const absl::Status status = run.CheckStarted(grid, units);
  if (status.ok()) return kExitDone;
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return kExitUnitFailed;
}

void AnnouncePlan(const std::string& command, const std::vector<PlannedUnit>& units,
                  const LaunchOptions& launch) {
  int episodes = 0;
  for (const PlannedUnit& unit : units) episodes += unit.EpisodeCount();
  std::fprintf(stderr, "%s: %zu units, %d episodes, %d workers, into %s\n", command.c_str(),
               units.size(), episodes, launch.workers, launch.run_dir.c_str());
  const bool slow = std::any_of(units.begin(), units.end(), [](const PlannedUnit& unit) {
    return unit.config.policy == kLiberoPolicy && FindSuite(unit.config.suite)->needs_libero &&
           unit.config.sim.pictures == SimOptions::kOriginalPictures;
  });
  if (slow) {
    std::fprintf(stderr,
                 "%s learned from quickly drawn views, and its published results are with them: "
                 "--set sim.pictures=plain, with which an episode takes a fifth to a third of the "
                 "time\n",
                 kLiberoPolicy);
  }
  std::set<std::string> strange;
  for (const PlannedUnit& unit : units) {
    const UnitConfig& config = unit.config;
    if (!IsSuitePolicy(config.policy)) continue;
    const bool libero = FindSuite(config.suite)->needs_libero;
    if (libero == (config.policy == kLiberoPolicy)) continue;
    strange.insert(absl::StrCat(config.policy, " has not learned the words and scenes of ",
                                libero ? "LIBERO's tasks" : "the embedded suites",
                                ": expect no success; ", libero ? kLiberoPolicy : "nano", " has"));
  }
  for (const std::string& line : strange) std::fprintf(stderr, "%s\n", line.c_str());
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
  if (!outcome.hint.empty())
    std::fprintf(stderr, "%s: %s\n", command.c_str(), outcome.hint.c_str());
  if (outcome.signal != 0 || outcome.submitted) return merged;
  // A call that ran nothing leaves the record of the machine that did.
  if (outcome.completed > 0) RS_RETURN_IF_ERROR(WriteEnvironment(launch.run_dir));
  if (outcome.completed + outcome.already_done > 0) {
    RS_ASSIGN_OR_RETURN(merged.run, LoadRun(launch.run_dir));
    RS_RETURN_IF_ERROR(WriteTables(*merged.run));
  }
  if (!outcome.failed.empty()) {
    std::fprintf(stderr, "%s: the same command tries what failed again, and nothing else\n",
                 command.c_str());
  }
  for (const std::string& id : outcome.failed) {
    std::fprintf(stderr, "%s: FAILED %s (%s/logs/%s.log)\n", command.c_str(), id.c_str(),
                 launch.run_dir.c_str(), id.c_str());
  }
  return merged;
}

int ExitCodeOf(const SweepOutcome& outcome) {
  if (outcome.signal != 0) return 128 + outcome.signal;
  return outcome.failed.empty() ? kExitDone : kExitUnitFailed;
}

}  // namespace robostress
