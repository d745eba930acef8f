// robostress-report: the report of a run directory, from its recorded episodes.

#include <cstdio>
#include <string>

#include "CLI/CLI.hpp"
#include "eval/report.h"
#include "eval/run_store.h"

int main(int argc, char** argv) {
  CLI::App app(
      "Writes report.html, report.json, table.csv, episodes.csv and figures/ of a run directory "
      "and prints the table.",
      "robostress report");
  std::string dir;
  robostress::ReportOptions options;
  app.add_option("RUN_DIR", dir, "The --out of a sweep")->required();
  app.add_option("--bootstrap", options.bootstrap_replicates, "Bootstrap replicates")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  app.add_option("--max-videos", options.max_videos, "Videos in the page")
      ->check(CLI::Range(0, 10000))
      ->capture_default_str();
  app.add_option("--max-video-mb", options.max_video_mb, "Video data in the page [MB]")
      ->check(CLI::Range(0.0, 2000.0))
      ->capture_default_str();
  app.footer(
      "\nExamples\n  robostress report runs/quick\n  robostress report runs/main --bootstrap 20000 "
      "--max-videos 0\n");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const absl::StatusOr<robostress::RunData> run = robostress::LoadRun(dir);
  absl::Status status = run.status();
  if (status.ok()) status = robostress::WriteTables(*run);
  if (status.ok()) status = robostress::WriteReport(*run, options);
  if (!status.ok()) {
    std::fprintf(stderr, "robostress report: %s\n", std::string(status.message()).c_str());
    return 1;
  }
  return 0;
}
