// robostress-close-loop: hides errors in the simulated arm, finds them from its logs, compares.

#include <cstdio>
#include <string>

#include "common/command_line.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/close_loop/close_loop.h"
#include "eval/close_loop/close_piper_loop.h"
#include "eval/close_loop/recording_flags.h"
#include "eval/launch/exit_code.h"

namespace {

constexpr char kExamples[] = R"(
Example
  robostress close-loop --hidden worn.yaml --out runs/circle
  robostress close-loop --hidden worn.yaml --arm piper --out runs/piper_circle

Records the expert under the hidden scenario, turns the joint logs into a rig that declares none of it, calibrates,
writes what was found as a scenario, plays the recorded actions of unseen episodes again without and with it, and
evaluates a policy under Clean, the hidden and the found scenario. The same command goes on where it was stopped.
With --arm piper an emulated Piper makes reaches, its client's recording is calibrated, and arms without and with what
was found are given the same targets; suite, tasks, policy, severity and rates are of the Panda only.
`robostress scenarios --effects` lists what a scenario file may hold.

Exit code: 0 the circle is complete, whatever was found; 1 a step failed; 2 the command is wrong.
)";

}  // namespace

int main(int argc, char** argv) {
  robostress::cli::App app("Hides errors in the simulated arm, finds them from its logs, compares.",
                           "robostress close-loop");
  app.footer(kExamples);
  robostress::CloseLoopOptions options;
  std::string tasks;
  app.add_option("--hidden", options.hidden,
                 "Scenario file with the effects to hide, or clean: the control")
      ->required();
  app.add_option("--out", options.out, "Directory to write")->required();
  std::string arm = "panda";
  app.add_option("--arm", arm, "panda (simulated, in a suite) or piper (emulated, on its bus)")
      ->check(robostress::cli::IsMember({"panda", "piper"}))
      ->capture_default_str();
  app.add_option("--policy", options.policy, "Policy to evaluate")->capture_default_str();
  app.add_option("--evaluated-episodes", options.evaluated_episodes,
                 "Of each task and scenario, from the reporting split")
      ->check(robostress::cli::Range(1, 20))
      ->capture_default_str();
  robostress::AddRecordingFlags(app, options, tasks);
  const auto run = [&]() -> absl::Status {
    if (arm == "piper") {
      RS_ASSIGN_OR_RETURN(const auto piper,
                          robostress::ClosePiperLoop({options.hidden, options.out, options.episodes,
                                                      options.surrogates, options.seed}));
      std::fputs(robostress::ClosePiperLoopTable(piper).c_str(), stdout);
      std::printf("%s/summary.json\n", options.out.c_str());
      return absl::OkStatus();
    }
    RS_RETURN_IF_ERROR(robostress::ReadTasks(tasks, options));
    RS_ASSIGN_OR_RETURN(const auto result, robostress::CloseLoop(options));
    std::fputs(robostress::CloseLoopTable(result).c_str(), stdout);
    std::printf("%s/summary.json\n", options.out.c_str());
    return absl::OkStatus();
  };
  return robostress::RunMain(app, argc, argv, run, robostress::ExitCodeOfError);
}
