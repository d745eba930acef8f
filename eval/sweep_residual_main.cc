// robostress-residual: the table of residual magnitudes for both goal references, with the share
// that is controller lag.

#include <algorithm>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/launch/exit_code.h"
#include "eval/launch/grid_flags.h"
#include "eval/launch/merged_sweep.h"
#include "eval/plan/plan.h"
#include "eval/report/residual_table.h"
#include "eval/report/text_table.h"
#include "eval/store/run_store.h"

namespace robostress {
namespace {

constexpr char kCommand[] = "residual";

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress residual --suite tabletop_goal --scenario heavy_payload --policy expert\n"
    "  robostress residual --suites tabletop_spatial,tabletop_goal --episodes 10 --workers 4 "
    "--out runs/residual\n"
    "  robostress residual --suite tabletop_object --tasks 0,5 --policy weights.safetensors "
    "--goal-references achieved\n"
    "  robostress residual --suite tabletop_goal --policy pi0 --server 10.0.0.7:50051\n"
    "  robostress residual --suite libero_goal --tasks 8-8 --policy replay --replay-file "
    "actions.safetensors \\\n"
    "      --out runs/libero_residual\n\n"
    "Columns: residual, ||eta|| / ||a|| per rollout, averaged over rollouts, as in the paper's "
    "tab:residual-magnitude;\n"
    "lag, what the same commands leave when they are played again without joint errors from the "
    "same initial states;\n"
    "errors add, residual minus lag [points]; lag share, lag over residual per rollout; tracking "
    "scale, ||dx / g - a|| / ||a||\n"
    "with a nominal arm's steady gain g (method.tracking_gain). [a, b]: 95 % over episodes.\n"
    "Defaults: suite tabletop_goal, policy nano (LIBERO's: nano-libero), method base, five "
    "episodes per task.\n"
    "Leaves residual.csv (one row per episode), residual.md and a run directory per goal "
    "reference. Running a command\n"
    "again completes what is missing. Exit code: 0 all done, 1 a unit failed, 2 the command is "
    "wrong, 130 interrupted.\n";

struct CommandLine {
  bool dry_run = false;
  std::string out = "runs/residual";
  std::vector<std::string> goal_references = {"achieved", "desired"};
  int bootstrap_replicates = 4000;
  LaunchOptions launch;
  GridFlags grid;
};

void DeclareFlags(cli::App& app, CommandLine& line) {
  app.add_option("--out", line.out, "Directory to write")->capture_default_str();
  app.add_option("--goal-references,--goal-reference", line.goal_references,
                 "What a command is relative to: achieved, desired")
      ->delimiter(',')
      ->capture_default_str();
  DeclareLaunchFlags(app, line.launch);
  app.add_option("--bootstrap", line.bootstrap_replicates, "Bootstrap replicates")
      ->check(cli::Range(1, 1000000))
      ->capture_default_str();
  app.add_flag("--dry-run", line.dry_run, "Print the units and stop");
  DeclareGridFlags(app, line.grid);
  app.footer(kExamples);
}

// One run directory: everything at one goal reference.
struct ReferenceRun {
  std::string dir;
  SweepGrid grid;
  std::vector<PlannedUnit> units;
};

absl::StatusOr<SweepGrid> GridFrom(const cli::App& app, const CommandLine& line) {
  SweepGrid grid;
  grid.methods = {"base"};
  grid.episodes = 5;
  RS_RETURN_IF_ERROR(ApplyGridFlags(app, line.grid, grid));
  for (const std::string& assignment : grid.overrides) {
    if (absl::StartsWith(assignment, "sim.goal_reference=")) {
      return absl::InvalidArgumentError(
          absl::StrCat("override '", assignment,
                       "' contradicts the comparison of goal references; use --goal-references"));
    }
  }
  return ResolveGrid(std::move(grid), PolicyHomeOf(line.launch));
}

absl::StatusOr<std::vector<ReferenceRun>> PlanRuns(const cli::App& app, const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const SweepGrid grid, GridFrom(app, line));
  std::vector<ReferenceRun> runs;
  for (const std::string& reference : line.goal_references) {
    ReferenceRun run{absl::StrCat(line.out, "/", reference), grid, {}};
    run.grid.overrides.push_back("sim.goal_reference=" + reference);
    RS_ASSIGN_OR_RETURN(run.units, ExpandUnits(run.grid));
    for (const ReferenceRun& other : runs) {
      if (other.dir != run.dir) continue;
      return absl::InvalidArgumentError(
          absl::StrCat("goal reference ", reference, " is given twice; remove one"));
    }
    runs.push_back(std::move(run));
  }
  return runs;
}

// Appends the units of one goal reference; its name becomes a column of the episode table.
void Append(RunData run, RunData& all) {
  for (UnitResult& unit : run.units) {
    for (EpisodeRow& row : unit.episodes) {
      nlohmann::json fields = nlohmann::json::parse(row.record);
      fields["goal_reference"] = GoalReferenceName(unit.config.sim.goal_reference);
      row.record = fields.dump();
    }
    all.units.push_back(std::move(unit));
  }
}

absl::Status WriteResults(const RunData& run, const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const std::vector<ResidualTable> tables,
                      MakeResidualTables(run, line.bootstrap_replicates));
  std::string markdown;
  for (const ResidualTable& table : tables) {
    const TextRows cells = ResidualCells(table);
    std::printf("\n%s\n%s", ResidualHeading(table).c_str(), AlignedTable(cells).c_str());
    absl::StrAppend(&markdown, ResidualHeading(table), "\n\n", MarkdownTable(cells), "\n");
  }
  RS_RETURN_IF_ERROR(WriteFileAtomically(line.out + "/residual.csv", EpisodeTableCsv(run)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(line.out + "/residual.md", markdown));
  std::printf("\nepisodes: %s/residual.csv\ntables: %s/residual.md\n", line.out.c_str(),
              line.out.c_str());
  return absl::OkStatus();
}

absl::StatusOr<int> Run(const cli::App& app, CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const std::vector<ReferenceRun> runs, PlanRuns(app, line));
  line.launch.measure_lag = true;
  RunData all;
  int exit_code = 0;
  for (const ReferenceRun& run : runs) {
    line.launch.run_dir = run.dir;
    AnnouncePlan(kCommand, run.units, line.launch);
    if (line.dry_run) {
      for (const PlannedUnit& unit : run.units)
        std::printf("%s/%s\n", run.dir.c_str(), unit.id.c_str());
      continue;
    }
    RS_ASSIGN_OR_RETURN(MergedSweep merged,
                        RunAndMerge(kCommand, run.grid, run.units, line.launch));
    if (merged.outcome.signal != 0) return ExitCodeOf(merged.outcome);
    exit_code = std::max(exit_code, ExitCodeOf(merged.outcome));
    if (merged.run) Append(*std::move(merged.run), all);
  }
  if (all.units.empty()) return exit_code;
  RS_RETURN_IF_ERROR(WriteResults(all, line));
  return exit_code;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Measures a policy's residual across scenarios, for both goal references, and the share of "
      "it "
      "that is controller lag.",
      "robostress residual");
  robostress::CommandLine line;
  robostress::DeclareFlags(app, line);
  return robostress::RunMain(
      app, argc, argv, [&] { return robostress::Run(app, line); }, robostress::ExitCodeOfError);
}
