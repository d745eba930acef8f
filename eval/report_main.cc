// robostress-report: the report of a run directory, from its recorded episodes.

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/report/report.h"
#include "eval/report/store_comparison.h"
#include "eval/report/text_table.h"
#include "eval/store/run_store.h"

namespace robostress {
namespace {

// Two stores beside each other: compare.html, .json and .csv in `out`.
absl::Status Compare(const std::vector<std::string>& dirs, const std::string& out,
                     const ReportOptions& options) {
  RS_ASSIGN_OR_RETURN(const RunData first, LoadRun(dirs[0]));
  RS_ASSIGN_OR_RETURN(const RunData second, LoadRun(dirs[1]));
  RS_ASSIGN_OR_RETURN(const StoreComparison comparison,
                      CompareStores(first, second, options.bootstrap_replicates));
  const std::string folder = out.empty() ? "runs/compare" : out;
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  const TextRows cells = StoreCells(comparison);
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.md", MarkdownTable(cells)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.csv", CsvTable(cells)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.json", StoreJson(comparison)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.html", StorePage(comparison)));
  std::printf("%s", AlignedTable(cells).c_str());
  for (const std::string& note : comparison.notes) std::printf("  - %s\n", note.c_str());
  std::printf("%s/compare.html\n", folder.c_str());
  return absl::OkStatus();
}

absl::Status Report(const std::string& dir, const std::vector<std::string>& training,
                    const std::string& out, ReportOptions& options) {
  for (const std::string& folder : training) {
    RS_ASSIGN_OR_RETURN(TrainingRun run, LoadTrainingRun(folder));
    const bool taken =
        std::any_of(options.training.begin(), options.training.end(),
                    [&](const TrainingRun& other) { return other.name == run.name; });
    if (taken) run.name = folder;
    options.training.push_back(std::move(run));
  }
  if (dir.empty() && training.empty())
    return absl::InvalidArgumentError("nothing to report; give RUN_DIR or --training DIR");
  if (dir.empty()) {
    const std::string page = out.empty() ? training[0] + "/training.html" : out;
    RS_RETURN_IF_ERROR(WriteFileAtomically(page, TrainingPage(options.training)));
    std::printf("%s\n", page.c_str());
    return absl::OkStatus();
  }
  RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(dir));
  RS_RETURN_IF_ERROR(WriteTables(run));
  return WriteReport(run, options);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Writes report.html, report.json, table.csv, episodes.csv and figures/ of a run directory "
      "and prints the table.",
      "robostress report");
  std::string dir, out;
  std::vector<std::string> training, compare;
  robostress::ReportOptions options;
  app.add_option("RUN_DIR", dir, "The --out of a sweep");
  app.add_option("--training", training,
                 "The --out of `robostress train`, may be given more than once: its curves go into "
                 "the report, or, without RUN_DIR, into a page of their own");
  app.add_option("--compare", compare,
                 "FIRST SECOND: success of two run directories and their differences, paired where "
                 "episodes pair")
      ->expected(2);
  app.add_option("--out", out,
                 "Of --training: that page (default: training.html in the first of them); of "
                 "--compare: a folder (default: runs/compare)");
  app.add_option("--bootstrap", options.bootstrap_replicates, "Bootstrap replicates")
      ->check(robostress::cli::Range(1, 1000000))
      ->capture_default_str();
  app.add_option("--max-videos", options.max_videos, "Videos in the page")
      ->check(robostress::cli::Range(0, 10000))
      ->capture_default_str();
  app.add_option("--max-video-mb", options.max_video_mb, "Video data in the page [MB]")
      ->check(robostress::cli::Range(0.0, 2000.0))
      ->capture_default_str();
  app.footer(
      "\nExamples\n  robostress report runs/quick\n  robostress report --training runs/base "
      "--training runs/dr\n  robostress report runs/main --training runs/dr\n  robostress "
      "report --compare runs/before runs/after --out runs/compare\n  robostress report "
      "runs/main --bootstrap 20000 "
      "--max-videos 0\n");
  return robostress::RunMain(app, argc, argv, [&] {
    return compare.empty() ? robostress::Report(dir, training, out, options)
                           : robostress::Compare(compare, out, options);
  });
}
