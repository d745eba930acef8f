// robostress-identify: finds the joint errors of simulated arms from their own first episodes.

#include <cstdio>
#include <string>

#include "common/command_line.h"
#include "common/embedded_policies.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/close_loop/identify.h"
#include "eval/close_loop/identify_response.h"
#include "eval/close_loop/recording_flags.h"
#include "eval/launch/exit_code.h"

namespace {

constexpr char kExamples[] = R"(
Example
  robostress identify --scenarios heavy_payload,worn.yaml --out identified
  robostress sweep --scenarios heavy_payload,worn.yaml --methods base,ours_identified --out runs/identified
  robostress identify --run runs/piper_tuesday --out identified/piper

Plays a policy's first episodes under each scenario, calibrates a model that knows none of its errors with the joint
logs, and writes what was found to OUT/SCENARIO_found.yaml, which method `ours_identified` reads: it chooses the command
whose predicted motion is that of an arm without errors. The same command goes on where it was stopped.
--run reads what robot_client recorded of a healthy arm instead, and writes OUT/response.yaml: how its joints answer
targets, for the disturbance observer of the client's configuration.

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
      ->delimiter(',');
  std::string arm_run;
  app.add_option("--run", arm_run, "A run of robot_client: reaches, or what `excite` plays");
  app.add_option("--out", options.out, "Directory to write")->required();
  app.add_option("--policy", options.policy,
                 "Whose episodes are recorded: nano (on LIBERO's suites nano-libero), expert")
      ->capture_default_str();
  robostress::AddRecordingFlags(app, options, tasks);
  const auto run = [&]() -> absl::Status {
    if (arm_run.empty() == options.scenarios.empty())
      return absl::InvalidArgumentError(
          "give --scenarios for simulated arms, or --run for what robot_client recorded");
    if (!arm_run.empty()) {
      RS_ASSIGN_OR_RETURN(
          const auto response,
          robostress::IdentifyResponse(arm_run, options.out, options.surrogates, options.seed));
      std::fputs(robostress::ResponseTable(response).c_str(), stdout);
      return absl::OkStatus();
    }
    if (app.count("--policy") == 0 && robostress::IsLiberosOwn(options.suite))
      options.policy = robostress::kLiberoPolicy;
    RS_RETURN_IF_ERROR(robostress::ReadTasks(tasks, options));
    RS_ASSIGN_OR_RETURN(const auto arms, robostress::Identify(options));
    std::fputs(robostress::IdentifiedTable(arms).c_str(), stdout);
    return absl::OkStatus();
  };
  return robostress::RunMain(app, argc, argv, run, robostress::ExitCodeOfError);
}
