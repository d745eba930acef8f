// robostress-identify: finds the joint errors of simulated arms from their own first episodes.

#include <cstdio>
#include <string>

#include "common/command_line.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/close_loop/identify.h"
#include "eval/launch/exit_code.h"
#include "eval/plan/plan.h"

namespace {

constexpr char kExamples[] = R"(
Example
  robostress identify --scenarios heavy_payload,worn.yaml --out identified
  robostress sweep --scenarios heavy_payload,worn.yaml --methods base,ours_identified --out runs/identified

Plays a policy's first episodes under each scenario, calibrates a model that knows none of its errors with the joint
logs, and writes what was found to OUT/SCENARIO_found.yaml, which method `ours_identified` reads: it chooses the command
whose predicted motion is that of an arm without errors. The same command goes on where it was stopped.

Exit code: 0 all are identified, whatever was found; 1 a step failed; 2 the command is wrong.
)";

}  // namespace

int main(int argc, char** argv) {
  robostress::cli::App app("Finds joint errors of simulated arms from their own first episodes.",
                           "robostress identify");
  app.footer(kExamples);
  robostress::IdentifyOptions options;
  std::string tasks;
  app.add_option("--scenarios,--scenario", options.scenarios,
                 "One arm each: see `robostress scenarios`, or scenario files")
      ->required()
      ->delimiter(',');
  app.add_option("--out", options.out, "Directory to write")->required();
  app.add_option("--policy", options.policy, "Whose episodes are recorded: nano, expert")
      ->capture_default_str();
  app.add_option("--suite", options.suite, "See `robostress suites`")->capture_default_str();
  app.add_option("--tasks", tasks, "Task indices (default 0,1,3); the last is the transfer regime");
  app.add_option("--episodes", options.episodes, "Recorded of each task, from the dev split")
      ->check(robostress::cli::Range(1, 10))
      ->capture_default_str();
  app.add_option("--severity", options.severity, "Level of the scenarios")
      ->check(robostress::cli::Range(1, 5))
      ->capture_default_str();
  app.add_option("--workers", options.workers, "Worker processes")
      ->check(robostress::cli::Range(1, 256))
      ->capture_default_str();
  app.add_option("--rate-hz", options.rate_hz, "Rows per second of the rig's logs")
      ->capture_default_str();
  app.add_option("--surrogates", options.surrogates, "Of calibrate's null distributions")
      ->check(robostress::cli::Range(99, 100000))
      ->capture_default_str();
  app.add_option("--seed", options.seed, "Of encoder noise and surrogates")->capture_default_str();
  const auto run = [&]() -> absl::Status {
    if (!tasks.empty()) {
      RS_ASSIGN_OR_RETURN(options.tasks, robostress::ParseTasks(tasks));
    }
    RS_ASSIGN_OR_RETURN(const auto arms, robostress::Identify(options));
    std::fputs(robostress::IdentifiedTable(arms).c_str(), stdout);
    return absl::OkStatus();
  };
  return robostress::RunMain(app, argc, argv, run, robostress::ExitCodeOfError);
}
