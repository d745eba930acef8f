// robostress-report: the report of a run directory, from its recorded episodes.

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/report/leaderboard.h"
#include "eval/report/report.h"
#include "eval/report/result_export.h"
#include "eval/report/result_file.h"
#include "eval/report/store_comparison.h"
#include "eval/store/run_store.h"

namespace robostress {
namespace {

// What else of a run is written: for other laboratories, for vla-eval's leaderboard.
struct ExportFlags {
  std::string file, leaderboard;
  std::vector<std::string> entry;  // --leaderboard KEY=VALUE

  bool any() const { return !file.empty() || !leaderboard.empty(); }
};

// Writes what `flags` names, and no page.
absl::Status Export(const std::vector<std::string>& dirs, const ExportFlags& flags,
                    const ReportOptions& options) {
  LeaderboardEntry entry;
  if (!flags.leaderboard.empty()) {
    RS_ASSIGN_OR_RETURN(entry, ParseLeaderboardEntry(flags.entry));
  } else if (!flags.entry.empty()) {
    return absl::InvalidArgumentError("--leaderboard belongs to --export-leaderboard FILE");
  }
  RS_ASSIGN_OR_RETURN(const RunData run, JoinRuns(dirs));
  RS_ASSIGN_OR_RETURN(const ResultFile results,
                      ExportResults(run, Summarise(run, options.bootstrap_replicates)));
  if (!flags.file.empty()) {
    RS_RETURN_IF_ERROR(WriteFileAtomically(flags.file, WriteResultFile(results)));
    std::printf("%s: %zu results of %zu units\n", flags.file.c_str(), results.results.size(),
                run.units.size());
  }
  if (flags.leaderboard.empty()) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(
      const std::string leaderboard,
      LeaderboardJson(results, entry,
                      absl::FormatTime("%Y-%m-%d", absl::Now(), absl::UTCTimeZone())));
  RS_RETURN_IF_ERROR(WriteFileAtomically(flags.leaderboard, leaderboard));
  std::printf("%s\n", flags.leaderboard.c_str());
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
  std::string out;
  std::vector<std::string> dirs, training, compare;
  robostress::ExportFlags exported;
  robostress::ReportOptions options;
  app.add_option("RUN_DIR", dirs, "The --out of a sweep; several for --export alone");
  app.add_option("--export", exported.file,
                 "Write only this JSON file, for other laboratories: numbers, intervals, protocol, "
                 "versions (schema: eval/docs/result.schema.json)");
  app.add_option("--export-leaderboard", exported.leaderboard,
                 "Write only this JSON file: entries for vla-eval's leaderboard");
  app.add_option("--leaderboard", exported.entry,
                 "KEY=VALUE of the entries: model, weight_type, curated_by; display_name, params, "
                 "model_paper, reported_paper")
      ->allow_extra_args(false);
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
      "--max-videos 0\n  robostress report runs/main --export main.json\n  robostress report "
      "runs/pi05 --export-leaderboard pi05.json --leaderboard model=black25pi05 \\\n      "
      "--leaderboard weight_type=finetuned --leaderboard curated_by=@me\n");
  return robostress::RunMain(app, argc, argv, [&]() -> absl::Status {
    if (!compare.empty())
      return robostress::CompareRunDirectories(compare[0], compare[1], out,
                                               options.bootstrap_replicates);
    if (exported.any()) return robostress::Export(dirs, exported, options);
    if (!exported.entry.empty())
      return absl::InvalidArgumentError("--leaderboard belongs to --export-leaderboard FILE");
    if (dirs.size() > 1)
      return absl::InvalidArgumentError(
          "a report is of one RUN_DIR; several are for --export, and `robostress store merge` "
          "joins "
          "them");
    return robostress::Report(dirs.empty() ? "" : dirs[0], training, out, options);
  });
}
