#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "eval/report/training_report.h"
#include "eval/statistics/summary.h"
#include "eval/store/run_store.h"

namespace robostress {

struct ReportOptions {
  int bootstrap_replicates = 4000;
  int max_videos = 32;                // the films of one episode stay together
  double max_video_mb = 24;           // of video data in the page
  bool print = true;                  // the table on standard output
  std::vector<TrainingRun> training;  // of the policies, shown where there are any
};

// Publishes RUN_DIR/episodes.csv (deterministic) and timings.csv.
absl::Status WriteTables(const RunData& run);
// Publishes RUN_DIR/report.html (one self-contained page), report.json, table.csv, table.md and
// figures/*.svg, and prints the table.
absl::Status WriteReport(const RunData& run, const ReportOptions& options);

// The parts of the report, as text.
std::string TerminalTable(const RunData& run, const Summary& summary);
// One sentence: success over the scenarios with errors, and each method's difference from base with
// its interval. Empty without base, another method or such a scenario.
std::string Conclusion(const SuccessTable& table);
// "" where every method has an average; else which lack what.
std::string MissingNote(const SuccessTable& table);
std::string TableCsv(const Summary& summary);
// The tables over all suites, for a README.
std::string TableMarkdown(const Summary& summary);
std::string ReportJson(const RunData& run, const Summary& summary);

}  // namespace robostress
