// robostress-environment: one task of a suite, played by another program over stdin and stdout.

#include <csignal>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "common/joint_errors/scenario_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/unit/unit_plan.h"
#include "nlohmann/json.hpp"
#include "sim_worker/environment/environment_door.h"
#include "sim_worker/sim_task.h"

namespace robostress {
namespace {

constexpr int kActionDim = 7;  // three displacements, three turns, the gripper

constexpr char kExamples[] = R"(Examples:
  # what gymnasium.make("robostress/TabletopGoal-v0", task=3, scenario="heavy_payload") starts
  robostress environment --task 3 --set suite=tabletop_goal --set scenario=heavy_payload

  # by hand, without views
  printf '{"reset": 0}\n{"step": [0.5, 0, 0, 0, 0, 0, -1]}\n' | robostress environment --set suite=tabletop_goal --no-views

The first line says the task; each request is a line of JSON, {"reset": STATE} or {"step": [7 numbers]}, and each answer
a line with the bytes of the views behind it. Keys of --set are those of a unit (`robostress worker --help`).
)";

struct CommandLine {
  std::vector<std::string> overrides;
  int task = 0;
  EnvironmentViews views{{"agentview", "robot0_eye_in_hand"}};
  bool no_views = false;
};

absl::Status Run(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const UnitConfig given, ReadUnit("", "", line.overrides));
  UnitConfig scripted = given;
  scripted.policy = "expert";  // whoever plays
  RS_ASSIGN_OR_RETURN(const UnitConfig unit, ResolveUnit(scripted));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<SimTask> task, MakeSimTask(unit, line.task));
  const nlohmann::ordered_json said = {{"suite", unit.suite},
                                       {"task", line.task},
                                       {"name", task->name()},
                                       {"instruction", task->instruction()},
                                       {"scenario", ScenarioLabel(unit.scenario)},
                                       {"severity", unit.severity},
                                       {"horizon", task->horizon()},
                                       {"action_dim", kActionDim},
                                       {"cameras", line.views.cameras},
                                       {"image_size", line.views.size}};
  std::cout << said.dump() << std::endl;
  return ServeEnvironment(*task, line.views, kActionDim, std::cin, std::cout);
}

int Main(int argc, char** argv) {
  // Set before any library starts threads: one environment, one core.
  setenv("LP_NUM_THREADS", "0", /*overwrite=*/0);
  setenv("OMP_NUM_THREADS", "1", 0);
  setenv("OPENBLAS_NUM_THREADS", "1", 0);
  std::signal(SIGPIPE, SIG_IGN);
  std::ios::sync_with_stdio(false);

  cli::App app("Lets another program play one task of a suite, over stdin and stdout.",
               "robostress environment");
  app.footer(kExamples);
  CommandLine line;
  app.add_option("--task", line.task, "number of the task in its suite")->capture_default_str();
  app.add_option("--set", line.overrides, "key.key=value of a unit, repeatable")
      ->allow_extra_args(false);
  auto* cameras = app.add_option("--cameras", line.views.cameras, "views of an answer, in order")
                      ->capture_default_str();
  app.add_flag("--no-views", line.no_views, "numbers alone: nothing is rendered")
      ->excludes(cameras);
  app.add_option("--size", line.views.size, "of a view's side [px]")
      ->check(cli::Range(8, 1024))
      ->capture_default_str();
  return RunMain(app, argc, argv, [&] {
    if (line.no_views) line.views.cameras.clear();
    return Run(line);
  });
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
