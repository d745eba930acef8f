#pragma once

#include <string>

#include "common/command_line.h"
#include "eval/close_loop/recorded_run.h"
#include "eval/plan/plan.h"

namespace robostress {

// The flags of `options`, which outlives `app`; `tasks` is read after parsing, by ReadTasks.
inline void AddRecordingFlags(cli::App& app, RecordingOptions& options, std::string& tasks) {
  app.add_option("--suite", options.suite, "See `robostress suites`")->capture_default_str();
  app.add_option("--tasks", tasks, "Task indices (default 0,1,3); the last is the transfer regime");
  app.add_option("--episodes", options.episodes, "Recorded of each task, from the dev split")
      ->check(cli::Range(1, 10))
      ->capture_default_str();
  app.add_option("--severity", options.severity, "Level of the scenarios")
      ->check(cli::Range(1, 5))
      ->capture_default_str();
  app.add_option("--workers", options.workers, "Worker processes")
      ->check(cli::Range(1, 256))
      ->capture_default_str();
  app.add_option("--rate-hz", options.rate_hz, "Rows per second of the rig's logs")
      ->capture_default_str();
  app.add_option("--surrogates", options.surrogates, "Of calibrate's null distributions")
      ->check(cli::Range(99, 100000))
      ->capture_default_str();
  app.add_option("--seed", options.seed, "Of encoder noise and surrogates")->capture_default_str();
}

inline absl::Status ReadTasks(const std::string& tasks, RecordingOptions& options) {
  if (tasks.empty()) return absl::OkStatus();
  auto parsed = ParseTasks(tasks);
  if (parsed.ok()) options.tasks = *std::move(parsed);
  return parsed.status();
}

}  // namespace robostress
