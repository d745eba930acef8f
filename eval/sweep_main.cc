// robostress-sweep: plans a grid of units, runs what is missing, merges the tables and writes the
// report.

#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/method_options.h"
#include "common/status_macros.h"
#include "eval/environment.h"
#include "eval/plan.h"
#include "eval/process.h"
#include "eval/report.h"
#include "eval/run_store.h"
#include "eval/sweep_runner.h"

namespace robostress {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress sweep --quick --out runs/quick\n"
    "  robostress sweep --full --methods base,ours,gain,null --seeds 0,1,2 --out runs/main\n"
    "  robostress sweep --suites tabletop_goal --tasks 0,3 --scenarios clean,heavy_payload "
    "--severities 1,3,5 --out runs/levels\n"
    "  robostress sweep --grid runs/main/sweep.yaml --out runs/again\n"
    "  robostress sweep --suites libero_goal --tasks 8-8 --policies expert --methods base "
    "--libero-root LIBERO \\\n"
    "      --robosuite-root robosuite --out runs/libero\n\n"
    "Running a command again completes what is missing and repeats nothing. Exit code: 0 all units "
    "done, 1 a unit\n"
    "failed, 2 the command is wrong, 130 interrupted.\n";

struct CommandLine {
  bool quick = false, full = false, dry_run = false, no_report = false;
  std::string grid_file, out;
  LaunchOptions launch;
  // Grid flags: absent means "as in --quick, --full or --grid".
  std::vector<std::string> suites, scenarios, policies, methods, overrides;
  std::vector<int> severities;
  std::vector<int64_t> seeds;
  std::string tasks;
  int episodes = 0, first_initial_state = 0, videos = 0;
  std::string replay_file, libero_root, robosuite_root, libero_fixtures;
};

void DeclareFlags(CLI::App& app, CommandLine& line) {
  app.add_flag("--quick", line.quick, "One suite, two tasks, ten episodes, videos: a first look");
  app.add_flag("--full", line.full,
               "The four embedded suites, all tasks, 20 episodes (wins over --quick)");
  app.add_option("--grid", line.grid_file,
                 "YAML file of a grid, such as a run's sweep.yaml; flags override it");
  app.add_option("--out", line.out, "Run directory (default: runs/quick, runs/full or runs/sweep)");
  app.add_option("--workers", line.launch.workers, "Worker processes")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_flag("--dry-run", line.dry_run, "Print the units and stop");
  app.add_flag("--no-report", line.no_report, "Run and merge only");
  app.add_option("--suites,--suite", line.suites, "See `robostress suites`")->delimiter(',');
  app.add_option("--tasks", line.tasks, "2: the first two; 0,3,7 or 2-5: indices; all");
  app.add_option("--episodes", line.episodes, "Consecutive episodes per task");
  app.add_option("--scenarios,--scenario", line.scenarios,
                 "See `robostress scenarios` (default: clean and the seven)")
      ->delimiter(',');
  app.add_option("--severities,--severity", line.severities, "Levels 1 to 5")->delimiter(',');
  app.add_option("--policies,--policy", line.policies, "nano, expert, replay, or a weights file")
      ->delimiter(',');
  app.add_option("--methods,--method", line.methods, absl::StrJoin(MethodNames(), ", "))
      ->delimiter(',');
  app.add_option("--seeds,--seed", line.seeds, "Seeds of the sampling noise")->delimiter(',');
  app.add_option("--first-initial-state", line.first_initial_state,
                 "0-19 reporting split, 40-49 dev split");
  app.add_option("--videos", line.videos, "Film the first N episodes of each task");
  app.add_option("--set", line.overrides, "sim.KEY=VALUE or method.KEY=VALUE, repeatable")
      ->allow_extra_args(false);
  app.add_option("--replay-file", line.replay_file, "Actions for policy replay");
  app.add_option("--libero-root", line.libero_root, "LIBERO checkout, for suites libero_*");
  app.add_option("--robosuite-root", line.robosuite_root,
                 "robosuite checkout, for suites libero_*");
  app.add_option("--libero-fixtures", line.libero_fixtures,
                 "Where cabinets, stoves and racks of libero_* stand at each episode: centred "
                 "(default), sampled, numpy[:SEED] (the originals' draw, seed 7), or a JSON table");
  app.footer(kExamples);
}

absl::StatusOr<SweepGrid> GridFrom(const CLI::App& app, const CommandLine& line) {
  SweepGrid grid;
  if (line.quick) grid = QuickGrid();
  if (line.full) grid = FullGrid();
  if (!line.grid_file.empty()) {
    RS_ASSIGN_OR_RETURN(grid, LoadConfig<SweepGrid>(line.grid_file));
  }
  if (app.count("--suites")) grid.suites = line.suites;
  if (app.count("--scenarios")) grid.scenarios = line.scenarios;
  if (app.count("--severities")) grid.severities = line.severities;
  if (app.count("--policies")) grid.policies = line.policies;
  if (app.count("--methods")) grid.methods = line.methods;
  if (app.count("--seeds")) grid.seeds = line.seeds;
  if (app.count("--episodes")) grid.episodes = line.episodes;
  if (app.count("--first-initial-state")) grid.first_initial_state = line.first_initial_state;
  if (app.count("--videos")) grid.videos = line.videos;
  if (app.count("--set"))
    grid.overrides.insert(grid.overrides.end(), line.overrides.begin(), line.overrides.end());
  if (app.count("--replay-file")) grid.replay_file = line.replay_file;
  if (app.count("--libero-root")) grid.libero_root = line.libero_root;
  if (app.count("--robosuite-root")) grid.robosuite_root = line.robosuite_root;
  if (app.count("--libero-fixtures")) grid.libero_fixtures = line.libero_fixtures;
  if (app.count("--tasks")) {
    RS_ASSIGN_OR_RETURN(grid.tasks, ParseTasks(line.tasks));
  }
  return ResolveGrid(std::move(grid));
}

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "robostress sweep: %s\n", std::string(status.message()).c_str());
  return status.code() == absl::StatusCode::kInvalidArgument ? 2 : 1;
}

void PrintPlan(const std::vector<PlannedUnit>& units, const CommandLine& line) {
  int episodes = 0;
  for (const PlannedUnit& unit : units) episodes += unit.EpisodeCount();
  std::fprintf(stderr, "sweep: %zu units, %d episodes, %d workers, into %s\n", units.size(),
               episodes, line.launch.workers, line.launch.run_dir.c_str());
}

int Run(const CLI::App& app, CommandLine& line) {
  const absl::StatusOr<SweepGrid> grid = GridFrom(app, line);
  if (!grid.ok()) return Fail(grid.status());
  const absl::StatusOr<std::vector<PlannedUnit>> units = ExpandUnits(*grid);
  if (!units.ok()) return Fail(units.status());
  line.launch.run_dir = !line.out.empty() ? line.out
                        : line.full       ? "runs/full"
                        : line.quick      ? "runs/quick"
                                          : "runs/sweep";
  PrintPlan(*units, line);
  if (line.dry_run) {
    for (const PlannedUnit& unit : *units) std::printf("%s\n", unit.id.c_str());
    return 0;
  }
  ChooseOpenMpBlas();
  const absl::StatusOr<SweepOutcome> outcome = RunSweep(*grid, *units, line.launch);
  if (!outcome.ok()) return Fail(outcome.status());
  if (outcome->already_done > 0) {
    std::fprintf(stderr, "sweep: %d of %zu units were already done\n", outcome->already_done,
                 units->size());
  }
  if (outcome->interrupted) return 130;
  // A call that ran nothing leaves the record of the machine that did.
  if (outcome->completed > 0) {
    if (const absl::Status status = WriteEnvironment(line.launch.run_dir); !status.ok())
      return Fail(status);
  }
  if (outcome->completed + outcome->already_done > 0) {
    const absl::StatusOr<RunData> run = LoadRun(line.launch.run_dir);
    if (!run.ok()) return Fail(run.status());
    if (const absl::Status status = WriteTables(*run); !status.ok()) return Fail(status);
    if (!line.no_report) {
      ReportOptions options;
      if (const absl::Status status = WriteReport(*run, options); !status.ok()) return Fail(status);
    }
  }
  for (const std::string& id : outcome->failed) {
    std::fprintf(stderr, "sweep: FAILED %s (%s/logs/%s.log)\n", id.c_str(),
                 line.launch.run_dir.c_str(), id.c_str());
  }
  return outcome->failed.empty() ? 0 : 1;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  CLI::App app(
      "Evaluates policies and methods over suites and scenarios on worker processes, then reports.",
      "robostress sweep");
  robostress::CommandLine line;
  robostress::DeclareFlags(app, line);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  return robostress::Run(app, line);
}
