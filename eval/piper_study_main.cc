// robostress-piper-study: the paper's real-arm experiments on emulated Pipers.

#include <cstdio>
#include <set>
#include <string>

#include "common/command_line.h"
#include "common/config.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/launch/exit_code.h"
#include "eval/piper_study/piper_study.h"
#include "eval/store/run_directory.h"

namespace {

constexpr char kExamples[] = R"(
Examples
  robostress piper-study --out runs/piper                   everything: record, train, evaluate, report
  robostress piper-study --out runs/try --quick             the same in minutes; its numbers mean nothing
  robostress piper-study evaluate report --out runs/piper --workers 2
  robostress piper-study --out runs/piper --dry-run         the units, and what is done
  robostress piper-study evaluate report --out runs/piper --experiments main --real-time
  robostress piper-study --out runs/own --base-weights b.safetensors --robust-weights r.safetensors

The same command goes on where it was stopped. --real-time plays the units with piper_emulator and robot_client, the
programs of a real arm, over UDP multicast on the loopback interface, one second for a second, into DIR/live.

Exit codes: 0 done; 1 a stage failed; 2 the command is wrong.
)";

struct CommandLine {
  std::string config;
  bool quick = false, dry_run = false;
  std::vector<std::string> stages, arms, experiments, overrides, settings;
  std::vector<int> tasks;
  std::string base_weights, robust_weights;
  int episodes = 0, demonstrations = 0;
};

absl::StatusOr<robostress::PiperStudyOptions> Resolve(const CommandLine& line) {
  robostress::PiperStudyOptions options =
      line.quick ? robostress::QuickPiperStudy() : robostress::PiperStudyOptions();
  if (!line.config.empty()) {
    RS_ASSIGN_OR_RETURN(options,
                        robostress::LoadConfig<robostress::PiperStudyOptions>(line.config));
  }
  if (!line.arms.empty()) options.arms = line.arms;
  if (!line.tasks.empty()) options.tasks = line.tasks;
  if (!line.experiments.empty()) options.experiments = line.experiments;
  if (line.episodes > 0) options.episodes = line.episodes;
  if (line.demonstrations > 0) options.demonstrations = line.demonstrations;
  if (!line.base_weights.empty()) options.base_weights = line.base_weights;
  if (!line.robust_weights.empty()) options.robust_weights = line.robust_weights;
  RS_RETURN_IF_ERROR(robostress::ApplyOverrides(line.settings, options));
  return options;
}

absl::StatusOr<int> DryRun(const robostress::PiperStudyOptions& options,
                           const robostress::PiperStudyLaunch& launch) {
  RS_ASSIGN_OR_RETURN(const auto plans,
                      PlanOf(options, launch, robostress::PolicyHome::kElsewhere));
  const robostress::RunDirectory run(launch.RunFolder());
  std::set<std::string> planned;
  int done = 0;
  for (const robostress::PiperTablePlan& plan : plans) {
    RS_ASSIGN_OR_RETURN(const auto units, robostress::PaperUnits(plan.grids));
    for (const robostress::PlannedUnit& unit : units) {
      if (!planned.insert(unit.id).second) continue;
      done += run.Done(unit.id);
      std::printf("%-60s %s\n", unit.id.c_str(), run.Done(unit.id) ? "done" : "");
    }
  }
  std::printf("%zu units of %d episodes, %d done\n", planned.size(), options.episodes, done);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  robostress::cli::App app("The paper's real-arm experiments on emulated Pipers.",
                           "robostress piper-study");
  app.footer(kExamples);
  CommandLine line;
  robostress::PiperStudyLaunch launch;
  app.add_option("stages", line.stages, "record, train, evaluate, report (default: all, in order)");
  app.add_option("--out", launch.out, "Directory of the study")->required();
  app.add_option("--config", line.config, "Options (YAML), as a study keeps them in study.yaml");
  app.add_flag("--quick", line.quick, "One arm, one task, a few steps of training");
  app.add_flag("--dry-run", line.dry_run, "Print the units only");
  app.add_flag("--real-time", launch.real_time, "Evaluate over UDP in real time");
  app.add_option("--udp-port", launch.udp_port, "Of the emulated arm in real time")
      ->check(robostress::cli::Range(1024, 65535))
      ->capture_default_str();
  app.add_option("--workers", launch.workers, "Processes at once")
      ->check(robostress::cli::Range(1, 256))
      ->capture_default_str();
  app.add_option("--arms", line.arms, "Wear profiles")->delimiter(',');
  app.add_option("--tasks", line.tasks, "1 to 4")->delimiter(',');
  app.add_option("--experiments", line.experiments, "main, dob, unseen")->delimiter(',');
  app.add_option("--episodes", line.episodes, "Of each arm, task and method")
      ->check(robostress::cli::Range(1, 1000));
  app.add_option("--demonstrations", line.demonstrations, "Of each arm and task")
      ->check(robostress::cli::Range(1, 1000));
  app.add_option("--base-weights", line.base_weights, "A trained policy (.safetensors)");
  app.add_option("--robust-weights", line.robust_weights, "Its counterpart of RobustVLA");
  app.add_option("--set", line.settings, "KEY=VALUE of study.yaml, repeatable")
      ->allow_extra_args(false);
  const auto run = [&]() -> absl::StatusOr<int> {
    if (!line.stages.empty()) launch.stages = line.stages;
    RS_ASSIGN_OR_RETURN(const robostress::PiperStudyOptions options, Resolve(line));
    if (line.dry_run) return DryRun(options, launch);
    return robostress::RunPiperStudy(options, launch);
  };
  return robostress::RunMain(app, argc, argv, run, robostress::ExitCodeOfError);
}
