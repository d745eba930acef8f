// robostress-store: the run directories of a lab as one store: index, verification, merging.

#include <cstdio>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/launch/exit_code.h"
#include "eval/report/report.h"
#include "eval/store/outcomes.h"
#include "eval/store/store_check.h"
#include "eval/store/store_index.h"
#include "eval/store/store_merge.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress store verify runs/main\n"
    "  robostress store merge runs/cluster_a runs/cluster_b --out runs/all\n"
    "  robostress store index --index runs/index.sqlite runs/main runs/levels\n"
    "  robostress store outcomes runs/main --out outcomes.jsonl\n"
    "  sqlite3 runs/index.sqlite \"SELECT method, scenario, AVG(success) FROM episodes JOIN units "
    "USING(store, unit) GROUP BY 1, 2\"\n\n"
    "Exit code: 0 complete and sound; 1 units are unfinished or missing, or another error; 2 the "
    "command is wrong; 3 damage,\n"
    "conflicts, different weights or options, all listed.\n";

struct CommandLine {
  std::vector<std::string> stores;
  std::string index, out;
  bool json = false;
};

void PrintJson(const StoreContents& contents) {
  nlohmann::json findings = nlohmann::json::array();
  for (const StoreFinding& finding : contents.findings) {
    findings.push_back({{"fault", StoreFaultName(finding.fault)},
                        {"store", finding.store},
                        {"unit", finding.unit},
                        {"text", finding.text}});
  }
  const nlohmann::json report = {{"finished_units", contents.finished}, {"findings", findings}};
  std::printf("%s\n", report.dump(1).c_str());
}

int ExitCodeOfFindings(const std::vector<StoreFinding>& findings) {
  int code = kExitDone;
  for (const StoreFinding& finding : findings) {
    if (IsBad(finding.fault)) return kExitBadStore;
    if (IsIncomplete(finding.fault)) code = kExitUnitFailed;
  }
  return code;
}

absl::StatusOr<int> Verify(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const StoreContents contents, CheckStores(line.stores));
  if (line.json) {
    PrintJson(contents);
  } else {
    std::printf("%s%d finished units, %zu findings\n", FindingsText(contents.findings).c_str(),
                contents.finished, contents.findings.size());
  }
  return ExitCodeOfFindings(contents.findings);
}

absl::StatusOr<int> Merge(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const MergeResult merged, MergeStores(line.stores, line.out));
  std::printf("%s%d units merged into %s, %d were there\n", FindingsText(merged.findings).c_str(),
              merged.copied, line.out.c_str(), merged.present);
  RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(line.out));
  RS_RETURN_IF_ERROR(WriteTables(run));
  return run.unfinished.empty() ? kExitDone : kExitUnitFailed;
}

absl::StatusOr<int> MakeIndex(const CommandLine& line) {
  const std::string file = line.index.empty() ? line.stores[0] + "/index.sqlite" : line.index;
  RS_ASSIGN_OR_RETURN(const IndexResult result, UpdateIndex(file, line.stores));
  for (const std::string& damage : result.damaged)
    std::fprintf(stderr, "damaged: %s\n", damage.c_str());
  std::printf("%s: %d units read, %d unchanged, %d removed\n", file.c_str(), result.read,
              result.unchanged, result.removed);
  return result.damaged.empty() ? kExitDone : kExitBadStore;
}

absl::StatusOr<int> WriteOutcomes(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(line.stores[0]));
  RS_ASSIGN_OR_RETURN(const std::string text, OutcomesText(run));
  RS_RETURN_IF_ERROR(WriteFileAtomically(line.out, text));
  std::printf("%s: outcomes of %zu units\n", line.out.c_str(), run.units.size());
  return kExitDone;
}

// Stores that contradict each other, a store that is damaged, anything else.
int ExitCodeOfStores(const absl::Status& status) {
  const bool bad = absl::IsFailedPrecondition(status) || absl::IsDataLoss(status);
  return bad ? kExitBadStore : ExitCodeOfError(status);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("Checks, merges, indexes and condenses run directories.",
                           "robostress store");
  app.footer(robostress::kExamples);
  app.require_subcommand(1);
  robostress::CommandLine line;
  const auto add = [&](const char* name, const char* help) {
    robostress::cli::App* command = app.add_subcommand(name, help);
    command->add_option("RUN", line.stores, "Run directories: the --out of sweeps")->required();
    return command;
  };
  robostress::cli::App* verify =
      add("verify", "Read everything and list all that is wrong or missing");
  verify->add_flag("--json", line.json, "As JSON");
  robostress::cli::App* merge = add("merge", "Bring the finished units of several stores into one");
  merge->add_option("--out", line.out, "Run directory to make or extend")->required();
  robostress::cli::App* index = add("index", "Bring an SQLite index up to date, for questions");
  index->add_option("--index", line.index, "File (default: index.sqlite in the first RUN)");
  robostress::cli::App* outcomes = app.add_subcommand(
      "outcomes",
      "Write what every finished episode ended in, one line per unit, small enough to "
      "keep; `robostress paper --outcomes` reads it");
  outcomes->add_option("RUN", line.stores, "Run directory: the --out of a sweep")
      ->required()
      ->expected(1);
  outcomes->add_option("--out", line.out, "File to write")->required();
  const auto run = [&] {
    if (verify->parsed()) return robostress::Verify(line);
    if (outcomes->parsed()) return robostress::WriteOutcomes(line);
    if (merge->parsed()) return robostress::Merge(line);
    return robostress::MakeIndex(line);
  };
  return robostress::RunMain(app, argc, argv, run, robostress::ExitCodeOfStores);
}
