#include "eval/launch/sweep_runner.h"

#include <chrono>
#include <ctime>
#include <filesystem>
#include <memory>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "eval/launch/cluster_launchers.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using SteadyClock = std::chrono::steady_clock;

std::string UtcNow() {
  const std::time_t now = std::time(nullptr);
  char text[32];
  std::tm parts;
  std::strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", gmtime_r(&now, &parts));
  return text;
}

int CountDone(const RunDirectory& run, const std::vector<PlannedUnit>& units) {
  const std::unordered_set<std::string> started = run.StartedIds();
  int done = 0;
  for (const PlannedUnit& unit : units) done += started.count(unit.id) > 0 && run.Done(unit.id);
  return done;
}

// Parts whose last one was finished by a process that was killed before it joined them.
absl::Status JoinAll(const RunDirectory& run, const std::vector<PlannedUnit>& units) {
  std::error_code error;
  if (!std::filesystem::exists(run.path() + "/parts", error)) return absl::OkStatus();
  for (const PlannedUnit& unit : units) RS_RETURN_IF_ERROR(JoinParts(run, unit));
  return absl::OkStatus();
}

// Jobs of an earlier call write in the same directory.
absl::Status CheckQueue(const RunDirectory& run) {
  std::error_code error;
  if (!std::filesystem::exists(run.path() + "/submissions", error)) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(const std::string jobs, JobsInQueue(run));
  if (jobs.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("jobs of this run are still in Slurm's queue: ", jobs,
                   "; wait until they have left it, or end them with `scancel ", jobs, "`"));
}

absl::Status RecordLaunch(const RunDirectory& run, const std::string& started,
                          const LaunchOptions& options, const SweepOutcome& outcome) {
  nlohmann::json launch = {{"started", started},
                           {"wall_s", outcome.wall_s},
                           {"workers", options.workers},
                           {"completed", outcome.completed},
                           {"failed", outcome.failed}};
  if (options.launcher != "local") launch["launcher"] = options.launcher;
  return AppendLine(run.path() + "/launches.jsonl", launch.dump());
}

}  // namespace

absl::StatusOr<SweepOutcome> RunSweep(const SweepGrid& grid, const std::vector<PlannedUnit>& units,
                                      const LaunchOptions& options) {
  const auto start = SteadyClock::now();
  const std::string started = UtcNow();
  for (const PlannedUnit& unit : units) {
    const bool beside = options.measure_lag || options.record_joints || options.record_views > 0;
    if (unit.config.robot == UnitConfig().robot || !beside) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("unit ", unit.id, " is of robot ", unit.config.robot,
                     ": only the Panda's worker measures lag and records; leave that out"));
  }
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Launcher> launcher, MakeLauncher(options.launcher));
  const RunDirectory run(options.run_dir);
  RS_ASSIGN_OR_RETURN(const FileLock lock, run.Lock());
  RS_RETURN_IF_ERROR(run.Prepare(grid, units));
  RS_RETURN_IF_ERROR(CheckQueue(run));
  RS_RETURN_IF_ERROR(JoinAll(run, units));
  const std::vector<WorkItem> items = PendingItems(run, units, options.part_episodes);
  SweepOutcome outcome;
  outcome.already_done = CountDone(run, units);
  if (items.empty()) return outcome;
  SignalGuard signals;
  Progress progress(options.quiet ? Progress::Output::kNone : Progress::Output::kAutomatic);
  for (const WorkItem& item : items)
    progress.Expect(item.Name(), item.Folder(run) + "/episodes.jsonl", item.count);
  const absl::StatusOr<LaunchResult> result =
      launcher->Launch({run, grid, items, options, signals, progress});
  RS_RETURN_IF_ERROR(JoinAll(run, units));
  outcome.completed = CountDone(run, units) - outcome.already_done;
  outcome.wall_s = std::chrono::duration<double>(SteadyClock::now() - start).count();
  if (result.ok()) {
    outcome.failed = result->outcome.failed;
    outcome.signal = result->outcome.signal;
    outcome.submitted = result->submitted;
    outcome.hint = result->hint;
  } else if (absl::IsCancelled(result.status()) && signals.Received() != 0) {
    outcome.signal = signals.Received();
  }
  RS_RETURN_IF_ERROR(RecordLaunch(run, started, options, outcome));
  if (!result.ok() && outcome.signal == 0) return result.status();
  return outcome;
}

}  // namespace robostress
