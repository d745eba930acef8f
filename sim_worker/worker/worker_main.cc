// robostress-worker: runs one unit of a sweep (one suite, scenario, severity, policy, method and
// seed).

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/joint_errors/scenario_file.h"
#include "common/program_folder.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/unit_directory.h"
#include "sim_worker/arm_sensing.h"
#include "sim_worker/libero/libero_task.h"
#include "sim_worker/libero/setup.h"
#include "sim_worker/sim_task.h"
#include "sim_worker/simulator_row.h"
#include "sim_worker/worker/model_inversion.h"
#include "sim_worker/worker/observation_control.h"
#include "sim_worker/worker/sim_unit.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  # the scripted expert on one task, without a server
  robostress worker --set suite=tabletop_goal --set policy=expert --set tasks=[0] --set episodes=3 --out runs/expert

  # the embedded policy with self-compensation under Heavy Payload
  robostress serve --policy nano --listen 127.0.0.1:50051 &
  robostress worker --unit unit.yaml --server 127.0.0.1:50051 --out runs/unit

  # unit.yaml; keys that are absent keep their defaults, see DIR/config.yaml for all of them
  suite: tabletop_goal
  scenario: heavy_payload
  policy: nano
  method: {method: ours}
  tasks: [0, 1]
  episodes: 20

Exit codes: 0 complete; 1 it failed on the way, the same command continues; 2 bad input.
)";

// A simulated task whose arm knows its motion as `sim.sensing` says.
class SensedTask : public Robot {
 public:
  SensedTask(std::shared_ptr<SimTask> task, std::unique_ptr<ArmSensing> sensing)
      : task_(std::move(task)), sensing_(std::move(sensing)) {}

  absl::Status Reset(int initial_state) override {
    sensing_->StartEpisode(initial_state);
    return task_->Reset(initial_state);
  }
  absl::StatusOr<Observation> Observe(const PolicySpec& spec) override {
    return task_->Observe(spec);
  }
  absl::StatusOr<RobotState> Measure() override { return sensing_->Measure(task_->sim()); }
  absl::Status Step(const Eigen::VectorXf& command) override { return task_->Step(command); }
  bool Success() const override { return task_->Success(); }
  int horizon() const override { return task_->horizon(); }

 private:
  const std::shared_ptr<SimTask> task_;
  const std::unique_ptr<ArmSensing> sensing_;
};

absl::StatusOr<std::shared_ptr<CommandInversion>> MakeInversion(const UnitConfig& unit,
                                                                SimTask& task) {
  const std::string& model = unit.method->arm_model;
  if (model.empty()) return nullptr;
  const bool truth = model == MethodOptions::kTrueModel;
  const std::string file =
      truth ? unit.scenario
            : absl::StrReplaceAll(model, {{"{scenario}", ScenarioLabel(unit.scenario)}});
  if (!truth && !IsScenarioFile(file)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "method.arm_model=", model,
        " is neither truth nor a scenario file that ends in .yaml, such as what `robostress "
        "identify` leaves"));
  }
  if (!truth && !std::filesystem::exists(file)) {
    return absl::NotFoundError(absl::StrCat(
        "method.arm_model=", model, ": no file ", file, "; `robostress identify --scenarios ",
        unit.scenario, " --out identified` writes it, or set method.arm_model"));
  }
  RS_ASSIGN_OR_RETURN(const Scenario scenario, MakeScenario(file, unit.severity));
  RS_ASSIGN_OR_RETURN(
      std::shared_ptr<CommandInversion> inversion,
      truth ? ModelInversion::OfTruth(task.sim(), unit.sim, scenario, task.horizon())
            : ModelInversion::OfModel(task.sim(), unit.sim, scenario, task.horizon()));
  return inversion;
}

absl::StatusOr<UnitTask> MakeTask(const UnitConfig& unit, int task) {
  absl::StatusOr<std::unique_ptr<SimTask>> made = MakeSimTask(unit, task);
  if (!made.ok()) return made.status();
  const std::shared_ptr<SimTask> sim_task = *std::move(made);
  std::vector<std::string> instructions;  // which reads the files of tasks that are not played
  if (unit.method->observation == ObservationInput::kShuffledInstruction) {
    RS_ASSIGN_OR_RETURN(instructions, SuiteInstructions(unit));
  }
  std::shared_ptr<Robot> robot = sim_task;
  if (unit.sim.sensing.used()) {
    absl::StatusOr<std::unique_ptr<ArmSensing>> sensing =
        ArmSensing::Create(sim_task->sim().shared_model(), unit.sim.sensing);
    if (!sensing.ok()) return sensing.status();
    robot = std::make_shared<SensedTask>(sim_task, *std::move(sensing));
  }
  UnitTask out;
  RS_ASSIGN_OR_RETURN(out.inversion, MakeInversion(unit, *sim_task));
  out.robot = ControlObservations(robot, unit.method->observation, std::move(instructions), task);
  out.make_expert = [sim_task] { return MakeExpertPolicy(*sim_task); };
  out.listen_to_joints = [sim_task](std::function<void(const JointSample&)> call) {
    sim_task->sim().OnJointSample(std::move(call));
  };
  out.film = [sim_task](int height) { return sim_task->Film(height); };
  out.name = sim_task->name();
  out.problem = sim_task->problem();
  out.mjcf = [sim_task] { return sim_task->mjcf(); };
  out.moment = [sim_task](int side) -> absl::StatusOr<RecordedMoment> {
    PolicySpec views;
    views.cameras = {kAgentView, kWristView};
    views.image_width = views.image_height = side;
    RecordedMoment moment;
    RS_ASSIGN_OR_RETURN(moment.observation, sim_task->Observe(views));
    RS_ASSIGN_OR_RETURN(moment.simulator, ReadSimulator(sim_task->sim()));
    return moment;
  };
  return out;
}

int ExitCode(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return 0;
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kNotFound:
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kUnimplemented:
      return 2;
    default:
      return 1;
  }
}

// What provenance.json says of LIBERO's files; "" of other suites, and where they are not found,
// which the first task says.
std::string LiberoFiles(const UnitConfig& unit) {
  const SuiteInfo* suite = FindSuite(unit.suite);
  if (unit.libero_tasks.empty() && (suite == nullptr || !suite->needs_libero)) return "";
  const auto needed = libero::ReadNeededFiles(DataPath(libero::kNeededFiles));
  const auto paths = libero::FindLibero(unit.libero_root, unit.robosuite_root);
  if (!needed.ok() || !paths.ok()) return "";
  const std::string others = libero::OtherFiles(*paths, *needed);
  return others.empty() ? kLiberoFilesPublished : others;
}

absl::Status Run(const std::string& unit_file, const std::vector<std::string>& overrides,
                 const SimUnitOptions& options) {
  std::string yaml;
  if (!unit_file.empty()) {
    absl::StatusOr<std::string> text = ReadFile(unit_file);
    if (!text.ok()) return text.status();
    yaml = *std::move(text);
  }
  const absl::StatusOr<UnitConfig> unit = ReadUnit(unit_file, yaml, overrides);
  if (!unit.ok()) return unit.status();
  SimUnitOptions noted = options;
  if (const std::string files = LiberoFiles(*unit); !files.empty())
    noted.notes[kLiberoFiles] = files;
  bool checked = false;  // what is wrong with the last task is said before the first is played
  return RunSimUnit(*unit, noted,
                    [&checked](const UnitConfig& resolved, int task) -> absl::StatusOr<UnitTask> {
                      if (!checked && FindSuite(resolved.suite)->needs_libero)
                        RS_RETURN_IF_ERROR(CheckLiberoTasks(resolved));
                      checked = true;
                      return MakeTask(resolved, task);
                    });
}

int Main(int argc, char** argv) {
  // One unit, one core: sweeps run one worker per core. Set before any library starts threads.
  setenv("LP_NUM_THREADS", "0", /*overwrite=*/0);
  setenv("OMP_NUM_THREADS", "1", 0);
  setenv("OPENBLAS_NUM_THREADS", "1", 0);

  cli::App app(
      "Runs one unit of a sweep and writes its directory; the same command again continues it.",
      "robostress worker");
  app.footer(kExamples);
  std::string unit_file;
  std::vector<std::string> overrides;
  SimUnitOptions options;
  bool quiet = false;
  app.add_option("--unit", unit_file, "unit configuration (YAML); absent: defaults");
  app.add_option("--set", overrides, "key.key=value over the unit's configuration, repeatable")
      ->allow_extra_args(false);
  app.add_option("--out", options.run.out, "directory to write")->required();
  app.add_option(
      "--server", options.server,
      "HOST:PORT of a policy server, or ws://HOST:PORT of another's; not for expert and replay");
  app.add_option(
      "--episodes", options.run.episodes,
      "FIRST-LAST: only this range of the unit's episodes, in the order of execution; for "
      "methods without adaptation");
  app.add_option("--connect-timeout", options.connect_timeout_s,
                 "seconds until the server must accept")
      ->capture_default_str();
  app.add_option("--call-timeout", options.call_timeout_s, "seconds for any answer of the server")
      ->capture_default_str();
  app.add_flag("--lag", options.measure_lag,
               "also play each episode's commands without joint errors and add lag_residual to its "
               "row; see `robostress residual`");
  app.add_flag("--record-joints", options.record_joints,
               "also write joint angles, torques and contacts of every sub-step (500 Hz) to "
               "DIR/joints; see `robostress record-to-rig`");
  app.add_option(
         "--record-episodes", options.record_views,
         "PIXELS: also write views of PIXELS x PIXELS, commands and motion of every control "
         "step to DIR/episodes; see `robostress export`")
      ->check(cli::Range(16, 1024));
  app.add_flag("--quiet", quiet, "no progress lines");
  return RunMain(
      app, argc, argv,
      [&] {
        if (!quiet) {
          options.run.progress = [](std::string_view line) {
            std::printf("%.*s\n", static_cast<int>(line.size()), line.data());
            std::fflush(stdout);
          };
        }
        return Run(unit_file, overrides, options);
      },
      ExitCode);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
