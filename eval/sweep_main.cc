// robostress-sweep: plans a grid of units, runs what is missing, merges the tables and writes the
// report.

#include <string>
#include <vector>

#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/launch/exit_code.h"
#include "eval/launch/grid_flags.h"
#include "eval/launch/merged_sweep.h"
#include "eval/plan/plan.h"
#include "eval/plan/unit_filter.h"
#include "eval/report/report.h"

namespace robostress {
namespace {

constexpr char kCommand[] = "sweep";

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress sweep --quick --out runs/quick\n"
    "  robostress sweep --full --methods base,ours,gain,null --seeds 0,1,2 --out runs/main\n"
    "  robostress sweep --suites tabletop_goal --tasks 0,3 --scenarios clean,heavy_payload "
    "--severities 1,3,5 --out runs/levels\n"
    "  robostress sweep --scenarios clean,worn_elbow.yaml --policies nano --out runs/worn\n"
    "  robostress sweep --robot piper --methods base,dob,ours --out runs/piper\n"
    "  robostress sweep --grid runs/main/sweep.yaml --out runs/again\n"
    "  robostress sweep --suites libero_goal --tasks 8-8 --policies expert --methods base --out "
    "runs/libero\n"
    "  robostress sweep --full --launcher slurm --workers 64 --split-episodes 50 "
    "--slurm-worker=--partition=cpu --out /shared/runs/main\n"
    "  robostress sweep --full --out runs/main --only 'method=base,scenario=aged_*' --dry-run\n\n"
    "Running a command again completes what is missing and repeats nothing. Exit code: 0 all units "
    "done (or handed to a\n"
    "scheduler), 1 a unit failed or another error, 2 the command is wrong, 130 and 143 "
    "interrupted.\n";

struct CommandLine {
  bool quick = false, full = false, dry_run = false, no_report = false;
  std::string out;
  std::vector<std::string> only;
  LaunchOptions launch;
  GridFlags grid;
  int videos = 0;
};

void DeclareFlags(cli::App& app, CommandLine& line) {
  app.add_flag("--quick", line.quick, "One suite, two tasks, ten episodes, videos: a first look");
  app.add_flag("--full", line.full,
               "The four embedded suites, all tasks, 20 episodes (wins over --quick)");
  app.add_option("--out", line.out, "Run directory (default: runs/quick, runs/full or runs/sweep)");
  DeclareLaunchFlags(app, line.launch);
  DeclareClusterFlags(app, line.launch);
  app.add_flag("--record-joints", line.launch.record_joints,
               "Also record joint angles, torques and contacts of every sub-step; see `robostress "
               "record-to-rig`");
  app.add_option(
         "--record-episodes", line.launch.record_views,
         "PIXELS: also record views of PIXELS x PIXELS, commands and motion of every control "
         "step; see `robostress export`")
      ->check(cli::Range(16, 1024));
  app.add_flag("--dry-run", line.dry_run, "Print units, what is done and an estimate, and stop");
  app.add_flag("--no-report", line.no_report, "Run and merge only");
  DeclareGridFlags(app, line.grid);
  app.add_option("--videos", line.videos, "Film the first N episodes of each task");
  app.add_option("--only", line.only,
                 "KEY=PATTERN,...: only units that match; keys suite, scenario, severity, policy, "
                 "method, seed, unit; a key given twice: either")
      ->delimiter(',');
  app.footer(kExamples);
}

absl::StatusOr<SweepGrid> GridFrom(const cli::App& app, const CommandLine& line) {
  SweepGrid grid;
  if (line.quick) grid = QuickGrid();
  if (line.full) grid = FullGrid();
  RS_RETURN_IF_ERROR(ApplyGridFlags(app, line.grid, grid));
  if (app.count("--videos")) grid.videos = line.videos;
  return ResolveGrid(std::move(grid), PolicyHomeOf(line.launch));
}

absl::StatusOr<int> Run(const cli::App& app, CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const SweepGrid grid, GridFrom(app, line));
  RS_ASSIGN_OR_RETURN(std::vector<PlannedUnit> units, ExpandUnits(grid));
  RS_ASSIGN_OR_RETURN(units, FilterUnits(std::move(units), line.only));
  line.launch.run_dir = !line.out.empty() ? line.out
                        : line.full       ? "runs/full"
                        : line.quick      ? "runs/quick"
                                          : "runs/sweep";
  AnnouncePlan(kCommand, units, line.launch);
  if (line.dry_run) return PrintPlan(grid, units, line.launch);
  RS_ASSIGN_OR_RETURN(const MergedSweep merged, RunAndMerge(kCommand, grid, units, line.launch));
  if (merged.run && !line.no_report) RS_RETURN_IF_ERROR(WriteReport(*merged.run, ReportOptions()));
  return ExitCodeOf(merged.outcome);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Evaluates policies and methods over suites and scenarios on worker processes, then reports.",
      "robostress sweep");
  robostress::CommandLine line;
  robostress::DeclareFlags(app, line);
  return robostress::RunMain(
      app, argc, argv, [&] { return robostress::Run(app, line); }, robostress::ExitCodeOfError);
}
