// robostress-paper: one table of the paper, planned, run and laid out like the paper's.

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/embedded_policies.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/launch/exit_code.h"
#include "eval/launch/grid_flags.h"
#include "eval/launch/merged_sweep.h"
#include "eval/paper/paper_programs.h"
#include "eval/paper/paper_results.h"
#include "eval/paper/paper_table.h"
#include "eval/report/report_appendix.h"
#include "eval/store/outcomes.h"

namespace robostress {
namespace {

constexpr char kCommand[] = "paper";

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress paper --list\n"
    "  robostress paper main --quick                      a few minutes of nano on one suite\n"
    "  robostress paper main noise ablation --full --dry-run\n"
    "  robostress paper main --full --seeds 0 --out runs/paper\n"
    "  robostress paper main --full --weights pi0.safetensors --dr-weights dr.safetensors "
    "--libero-root LIBERO \\\n"
    "      --robosuite-root robosuite --out runs/paper-libero\n"
    "  robostress paper main --full --weights pi0 --server 10.0.0.7:50051 --out "
    "runs/paper-libero\n"
    "  robostress paper main --full --outcomes seed0.jsonl seed1.jsonl --out runs/again\n\n"
    "--quick is the default. Tables share their units in --out: what one ran, another only reads. "
    "Running a command\nagain completes what is missing and repeats nothing. Leaves "
    "OUT/tables/TABLE.html, .md, .csv and .json.\nExit code: 0 all done, 1 a unit or a program "
    "failed, 2 the command is wrong, 130 interrupted.\n";

struct CommandLine {
  std::vector<std::string> tables;
  bool quick = false, full = false, list = false, dry_run = false;
  std::string out, weights, randomised, robust, cloning, tasks;
  std::vector<std::string> outcomes;
  GridFlags grid;
  int videos = 0, bootstrap_replicates = 4000;
  LaunchOptions launch;
};

void DeclareFlags(cli::App& app, CommandLine& line) {
  app.add_option("TABLE", line.tables, "See --list; several, or all");
  auto* quick = app.add_flag("--quick", line.quick,
                             "One embedded suite, two tasks, ten episodes, one seed, films");
  app.add_flag("--full", line.full,
               "The paper's protocol: four suites, all tasks, 20 episodes, three seeds")
      ->excludes(quick);
  app.add_flag("--list", line.list, "List the tables with their size, and stop");
  app.add_flag("--dry-run", line.dry_run,
               "Print the units, which are done, what the rest will take, and stop");
  app.add_option("--out", line.out,
                 "Run directory, shared by tables (default: runs/paper-quick or runs/paper-full)");
  app.add_option("--weights", line.weights,
                 "A checkpoint, or the name of a policy that --server holds: LIBERO's suites, the "
                 "paper's learning rate (nano-libero: nano's)");
  app.add_option("--dr-weights", line.randomised, "Weights of the DR column");
  app.add_option("--robust-weights", line.robust, "Weights of the RobustVLA column");
  app.add_option("--cloning-weights", line.cloning,
                 "Weights of the cloning control: trained on as long as DR and RobustVLA");
  app.add_option("--suites,--suite", line.grid.suites, "Instead of the protocol's")->delimiter(',');
  app.add_option("--tasks", line.grid.tasks, "2: the first two; 0,3,7 or 2-5: indices; all");
  app.add_option("--episodes", line.grid.episodes, "Consecutive episodes per task");
  app.add_option("--seeds,--seed", line.grid.seeds, "Seeds of the sampling noise")->delimiter(',');
  app.add_option("--first-initial-state", line.grid.first_initial_state,
                 "0-19 reporting split, 40-49 dev split");
  app.add_option("--set", line.grid.overrides, "sim.KEY=VALUE or method.KEY=VALUE, repeatable")
      ->allow_extra_args(false);
  app.add_option("--libero-root", line.grid.libero_root, "LIBERO checkout");
  app.add_option("--robosuite-root", line.grid.robosuite_root, "robosuite checkout");
  app.add_option("--libero-fixtures", line.grid.libero_fixtures,
                 "centred (default), sampled, numpy[:SEED], or a JSON table");
  app.add_option("--videos", line.videos, "Film the first N episodes of each task");
  app.add_option("--bootstrap", line.bootstrap_replicates, "Bootstrap replicates")
      ->check(cli::Range(1, 1000000))
      ->capture_default_str();
  app.add_option("--outcomes", line.outcomes,
                 "Run nothing: lay the tables out from these files of `robostress store outcomes`");
  DeclareLaunchFlags(app, line.launch);
  DeclareClusterFlags(app, line.launch);
  app.footer(kExamples);
}

// Those asked for, or of the policy that has learned LIBERO's suites where they are asked for.
std::string Weights(const CommandLine& line) {
  const std::vector<std::string>& suites = line.grid.suites;
  const bool libero = !suites.empty() && std::all_of(suites.begin(), suites.end(), IsLiberosOwn);
  return line.weights.empty() && libero ? kLiberoPolicy : line.weights;
}

absl::StatusOr<PaperProtocol> ProtocolFrom(const cli::App& app, const CommandLine& line) {
  PaperProtocol protocol = line.full ? FullProtocol() : QuickProtocol();
  if (const std::string weights = Weights(line); !weights.empty())
    protocol = OnLibero(protocol, weights);
  if (app.count("--dr-weights")) protocol.randomised = line.randomised;
  if (app.count("--robust-weights")) protocol.robust = line.robust;
  if (app.count("--cloning-weights")) protocol.cloning = line.cloning;
  SweepGrid& grid = protocol.grid;
  if (app.count("--suites")) grid.suites = line.grid.suites;
  if (app.count("--tasks")) {
    RS_ASSIGN_OR_RETURN(grid.tasks, ParseTasks(line.grid.tasks));
  }
  if (app.count("--episodes")) grid.episodes = line.grid.episodes;
  if (app.count("--seeds")) grid.seeds = line.grid.seeds;
  if (app.count("--first-initial-state")) grid.first_initial_state = line.grid.first_initial_state;
  grid.overrides.insert(grid.overrides.end(), line.grid.overrides.begin(),
                        line.grid.overrides.end());
  if (app.count("--libero-root")) grid.libero_root = line.grid.libero_root;
  if (app.count("--robosuite-root")) grid.robosuite_root = line.grid.robosuite_root;
  if (app.count("--libero-fixtures")) grid.libero_fixtures = line.grid.libero_fixtures;
  if (app.count("--videos")) grid.videos = line.videos;
  return protocol;
}

// A table is laid out from finished units, so this program stays until they are.
absl::Status CheckLauncher(const LaunchOptions& launch) {
  if (launch.launcher == "local" || (launch.launcher == "slurm" && launch.cluster.wait))
    return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "--launcher ", launch.launcher, " hands units over and does not wait for them; ",
      launch.launcher == "slurm" ? "add --wait"
                                 : "let `robostress sweep` write the manifest, and run this again "
                                   "when its units are done"));
}

// One table, ready to run: its units by grid, or another program.
struct Work {
  PaperTable table;
  std::vector<SweepGrid> grids;
  std::vector<PlannedUnit> units;
};

absl::StatusOr<std::vector<Work>> Plan(const CommandLine& line, const PaperProtocol& protocol) {
  std::vector<std::string> names = line.tables;
  if (names.size() == 1 && names[0] == "all") {
    names.clear();
    for (const PaperTable& table : PaperTables()) names.push_back(table.name);
  }
  if (names.empty()) {
    return absl::InvalidArgumentError("no TABLE given; `robostress paper --list` names them");
  }
  RS_ASSIGN_OR_RETURN(const std::vector<PaperTable> tables, FindPaperTables(names));
  std::vector<Work> all;
  for (const PaperTable& table : tables) {
    Work work{table, {}, {}};
    if (work.table.program.empty()) {
      RS_ASSIGN_OR_RETURN(work.grids, PaperGrids(work.table, protocol, PolicyHomeOf(line.launch)));
      RS_ASSIGN_OR_RETURN(work.units, PaperUnits(work.grids));
    }
    all.push_back(std::move(work));
  }
  return all;
}

int Episodes(const std::vector<PlannedUnit>& units) {
  int episodes = 0;
  for (const PlannedUnit& unit : units) episodes += unit.EpisodeCount();
  return episodes;
}

void PrintList() {
  for (const PaperTable& table : PaperTables()) {
    const PublishedTable& published = *FindPublished(table.name);
    std::printf("%-9s %-24s %s\n", table.name.c_str(), published.label.c_str(),
                published.caption.c_str());
    if (!table.program.empty()) {
      std::printf("%35srobostress %s\n", "", table.program.c_str());
      continue;
    }
    for (const bool full : {false, true}) {
      const auto grids =
          PaperGrids(table, full ? FullProtocol() : QuickProtocol(), PolicyHome::kHere);
      if (!grids.ok()) continue;
      const auto units = PaperUnits(*grids);
      if (units.ok())
        std::printf("%35s%s: %zu units, %d episodes\n", "", full ? "--full" : "--quick",
                    units->size(), Episodes(*units));
    }
  }
}

bool IsDone(const std::string& out, const PlannedUnit& unit) {
  return std::filesystem::exists(absl::StrCat(out, "/units/", unit.id, "/DONE"));
}

// Units with their cost, table by table; the exit code, 1 when a run would be refused.
absl::StatusOr<int> PrintTables(const CommandLine& line, const std::vector<Work>& all) {
  int code = 0;
  for (const Work& work : all) {
    if (!work.table.program.empty()) {
      RS_ASSIGN_OR_RETURN(
          const std::vector<std::string> command,
          ProgramCommand({work.table, line.out, line.full, line.bootstrap_replicates}));
      std::printf("%s: %s\n", work.table.name.c_str(), absl::StrJoin(command, " ").c_str());
      continue;
    }
    std::vector<PlannedUnit> open;
    for (const PlannedUnit& unit : work.units) {
      if (!IsDone(line.out, unit)) open.push_back(unit);
    }
    std::printf("%s: %zu units, %d episodes; %zu units done, %d episodes to run, in %s\n",
                work.table.name.c_str(), work.units.size(), Episodes(work.units),
                work.units.size() - open.size(), Episodes(open), line.out.c_str());
    for (const SweepGrid& grid : work.grids) {
      RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
      code = std::max(code, PrintPlan(grid, units, line.launch));
    }
  }
  return code;
}

absl::Status Publish(const CommandLine& line, const FilledTable& table, const RunData* run) {
  const std::string folder = line.out + "/tables";
  ReportOptions options;
  RS_RETURN_IF_ERROR(
      WriteFilledTable(table, folder, run == nullptr ? "" : VideoSection(*run, options)));
  std::printf("%s\n%s/%s.html\n", FilledText(table).c_str(), folder.c_str(), table.name.c_str());
  return absl::OkStatus();
}

// One table from kept outcomes.
absl::Status LayOutKept(const CommandLine& line, const PaperProtocol& protocol, const Work& work,
                        const Outcomes& outcomes) {
  if (!work.table.program.empty() || work.table.measure != PaperMeasure::kSuccess) {
    return absl::InvalidArgumentError(absl::StrCat(
        "table ", work.table.name,
        " is not one of success, which is all that --outcomes holds; run it without --outcomes"));
  }
  RunData chosen = UnitsOf(outcomes.run, work.units);
  std::vector<std::string> notes = HoldAgainstPlan(work.units, chosen);
  FilledTable table =
      FillPaperTable(work.table, protocol, chosen, work.units, line.bootstrap_replicates);
  for (const auto& more : {notes, outcomes.notes})
    table.notes.insert(table.notes.end(), more.begin(), more.end());
  return Publish(line, table, nullptr);
}

// Runs one table; its exit code.
absl::StatusOr<int> RunTable(const CommandLine& line, const PaperProtocol& protocol,
                             const Work& work) {
  if (!work.table.program.empty()) {
    RS_ASSIGN_OR_RETURN(const FilledTable table, RunPaperProgram({work.table, line.out, line.full,
                                                                  line.bootstrap_replicates}));
    RS_RETURN_IF_ERROR(Publish(line, table, nullptr));
    return 0;
  }
  int code = 0;
  RunData run;
  for (const SweepGrid& grid : work.grids) {
    RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
    AnnouncePlan(absl::StrCat(kCommand, " ", work.table.name), units, line.launch);
    RS_ASSIGN_OR_RETURN(MergedSweep merged, RunAndMerge(kCommand, grid, units, line.launch));
    code = std::max(code, ExitCodeOf(merged.outcome));
    if (code > 128) return code;  // interrupted
    if (merged.run) run = *std::move(merged.run);
  }
  if (run.units.empty()) return code;  // nothing is finished here yet
  const RunData chosen = UnitsOf(run, work.units);
  FilledTable table =
      FillPaperTable(work.table, protocol, chosen, work.units, line.bootstrap_replicates);
  if (work.table.measure == PaperMeasure::kResidual)
    RS_RETURN_IF_ERROR(AddPiperResiduals(line.full ? 25 : 3, table));
  RS_RETURN_IF_ERROR(Publish(line, table, &chosen));
  return code;
}

// A table that cannot be made does not keep the others from being made.
int Fail(const absl::Status& status) {
  std::fprintf(stderr, "robostress %s: %s\n", kCommand, std::string(status.message()).c_str());
  return ExitCodeOfError(status);
}

absl::StatusOr<int> Run(const cli::App& app, CommandLine& line) {
  if (line.list) {
    PrintList();
    return 0;
  }
  RS_RETURN_IF_ERROR(CheckLauncher(line.launch));
  RS_ASSIGN_OR_RETURN(const PaperProtocol protocol, ProtocolFrom(app, line));
  RS_ASSIGN_OR_RETURN(const std::vector<Work> all, Plan(line, protocol));
  if (line.out.empty()) {
    line.out = absl::StrCat("runs/paper-", line.full ? "full" : "quick",
                            Weights(line).empty() ? "" : "-libero");
  }
  line.launch.run_dir = line.out;
  if (line.dry_run) return PrintTables(line, all);
  Outcomes outcomes;
  if (!line.outcomes.empty()) {
    RS_ASSIGN_OR_RETURN(outcomes, ReadOutcomes(line.outcomes));
  }
  int code = 0;
  for (const Work& work : all) {
    if (!line.outcomes.empty()) {
      const absl::Status kept = LayOutKept(line, protocol, work, outcomes);
      if (!kept.ok()) code = std::max(code, Fail(kept));
      continue;
    }
    const absl::StatusOr<int> of_table = RunTable(line, protocol, work);
    code = std::max(code, of_table.ok() ? *of_table : Fail(of_table.status()));
    if (code > 128) break;  // interrupted
  }
  return code;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Plans, runs and lays out tables of the paper, our numbers beside the published ones.",
      "robostress paper");
  robostress::CommandLine line;
  robostress::DeclareFlags(app, line);
  return robostress::RunMain(
      app, argc, argv, [&] { return robostress::Run(app, line); }, robostress::ExitCodeOfError);
}
