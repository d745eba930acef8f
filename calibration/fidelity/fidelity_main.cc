// robostress-fidelity: how near Heavy Payload comes to a real payload.

#include <algorithm>
#include <cstdio>
#include <string>
#include <thread>

#include "calibration/fidelity/fidelity_output.h"
#include "calibration/fidelity/fidelity_study.h"
#include "common/run_main.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kFooter[] =
    "\nReplays one pick-and-place demonstration with and without a payload, fits w_g and w_c of "
    "Heavy Payload\nto the deviation of the end effector, and compares the fitted model and "
    "Gaussian action noise with it on\nother layouts. The measured side is simulated (a true mass "
    "in the gripper) unless --measured names a folder\nwith replays.csv: "
    "t,x,y,z,held,loaded,replay "
    "(docs/results/calibration-fidelity.md).\n\nExamples\n"
    "  robostress fidelity --out runs/fidelity\n"
    "  robostress fidelity --out runs/fidelity --measured lab/piper_bowl\n\n"
    "Exit code: 0 done; 1 input is refused or a replay fails; 2 the command is wrong.\n";

struct CommandLine {
  FidelityOptions options;
  std::string out, goal_reference = "desired", gravity_sign = "payload", reference = "payload_free";
  bool quiet = false;
};

absl::Status Run(CommandLine line) {
  FidelityOptions& options = line.options;
  options.task.sim.goal_reference =
      line.goal_reference == "desired" ? GoalReference::kDesired : GoalReference::kAchieved;
  options.task.sim.joint_errors.gravity_sign =
      line.gravity_sign == "payload" ? GravitySign::kPayload : GravitySign::kLiteral;
  options.clean_reference = line.reference == "clean";
  if (!line.quiet) {
    options.progress = [](const std::string& text) {
      std::fprintf(stderr, "fidelity: %s\n", text.c_str());
    };
  }
  RS_ASSIGN_OR_RETURN(const FidelityResult result, RunFidelity(options));
  RS_RETURN_IF_ERROR(WriteFidelity(line.out, options, result));
  std::printf("%s\n%s/fidelity.html\n", FidelityTable(result).c_str(), line.out.c_str());
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CommandLine line;
  FidelityOptions& o = line.options;
  o.threads = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  cli::App app("Compares Heavy Payload and Gaussian action noise with a real payload",
               "robostress fidelity");
  app.add_option("--out", line.out, "Directory to write")->required();
  app.add_option("--measured", o.measured_dir, "Folder with replays.csv of a real arm");
  app.add_option("--payload", o.payload_kg, "True mass added to the carried object [kg]")
      ->check(cli::Range(0.0, 100.0))
      ->capture_default_str();
  app.add_option("--replays", o.replays, "Loaded, and unloaded, replays of the simulated arm")
      ->check(cli::Range(1, 100))
      ->capture_default_str();
  app.add_option("--suite", o.task.suite, "Embedded suite")->capture_default_str();
  app.add_option("--task", o.task.task, "Pick-and-place task of it")->capture_default_str();
  app.add_option("--demonstration-layout", o.demonstration_layout,
                 "Initial state that is replayed and fitted to")
      ->capture_default_str();
  app.add_option("--first-layout", o.first_layout, "First of the other initial states")
      ->capture_default_str();
  app.add_option("--layouts", o.layouts, "Number of the other initial states")
      ->capture_default_str();
  app.add_option("--noise-sigma", o.noise_sigma, "Of Gaussian noise on the normalised command")
      ->check(cli::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--noise-draws", o.noise_draws, "Replays with noise per layout")
      ->check(cli::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--reference", line.reference,
                 "Deviations of the model are from its replay without the payload, or without any "
                 "error")
      ->check(cli::IsMember({"payload_free", "clean"}))
      ->capture_default_str();
  app.add_option("--goal-reference", line.goal_reference,
                 "desired: absolute targets are replayed; achieved: deltas to the achieved pose")
      ->check(cli::IsMember({"desired", "achieved"}))
      ->capture_default_str();
  app.add_option("--gravity-sign", line.gravity_sign,
                 "payload: the gravity residual lets the arm sag; literal: the paper's sign")
      ->check(cli::IsMember({"payload", "literal"}))
      ->capture_default_str();
  app.add_option("--seed", o.seed, "Of scatter, noise and bootstrap")->capture_default_str();
  app.add_option("--replicates", o.replicates, "Of the bootstrap")
      ->check(cli::Range(100, 100000))
      ->capture_default_str();
  app.add_option("--threads", o.threads, "Replays at once")
      ->check(cli::Range(1, 256))
      ->default_str("one for each core");
  app.add_flag("--quiet", line.quiet, "No progress");
  app.footer(kFooter);
  return RunMain(app, argc, argv, [&] { return Run(line); });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
