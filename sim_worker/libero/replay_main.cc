// robostress-replay: plays recorded commands in a LIBERO task and writes what happened; compares
// two such files.

#include <cstdio>
#include <limits>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/config.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/libero/compare.h"
#include "sim_worker/libero/demonstration_replay.h"

namespace robostress::libero {
namespace {

constexpr char kExamples[] = R"(
FILE.safetensors holds actions [T, 7], init_state [1 + nq + nv] (time, qpos, qvel), reset_qpos [nq] and, for
the fixtures, body_pos [nbody, 3] and body_quat [nbody, 4]. The file written holds these, the
trajectory, row 0 before the first command, row t after command t (time, qpos, qvel, ctrl, torque [T+1, 7] in Nm,
ncon, success, reward, eef_pos, eef_quat as x y z w, gripper_qpos, goal_pos, goal_ori [T+1, 9]; goal_pos0, goal_ori0),
sub_torque_first10 [min(T, 10), 25, nu], and the compiled model's arrays under MuJoCo's names (model.*).

Examples
  robostress replay --suite libero_goal --task 0 --in recorded.safetensors --out ours.safetensors \
      --libero-root LIBERO --robosuite-root robosuite
  robostress replay --compare recorded.safetensors ours.safetensors
  robostress replay --compare recorded.safetensors ours.safetensors --tolerance 1e-9 --keys qpos eef_pos
  robostress replay --suite libero_goal --task 0 --in recorded.safetensors --out worn.safetensors \
      --scenario aged_joint_uniform --mode fast

Exit code: 0 done; 1 a difference is larger than --tolerance, or writing failed; 2 bad input.
)";

constexpr int kNoTask = std::numeric_limits<int>::min();

struct CommandLine {
  UnitConfig unit;
  int task = kNoTask, settle_steps = 10;
  std::string in, out, mode = "parity";
  std::vector<std::string> overrides, compare, keys;
  double tolerance = -1;
};

absl::StatusOr<UnitConfig> ResolvedUnit(const CommandLine& line) {
  UnitConfig unit = line.unit;
  if (!unit.suite.empty() && !unit.libero_tasks.empty()) {
    return absl::InvalidArgumentError(absl::StrCat("--suite ", unit.suite, " and --libero-tasks ",
                                                   unit.libero_tasks,
                                                   " name two suites; give one of them"));
  }
  if (line.mode == "parity") unit.sim.stepping = Stepping::kParity;
  RS_RETURN_IF_ERROR(ApplyOverrides(line.overrides, unit.sim));
  if (!unit.libero_tasks.empty()) {
    RS_ASSIGN_OR_RETURN(unit.suite, AddTaskFolder(unit.libero_tasks));
    unit.episodes = 1;
  }
  const SuiteInfo* suite = FindSuite(unit.suite);
  if (suite == nullptr || !suite->needs_libero) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--suite '", unit.suite,
        "' is not one of LIBERO's: libero_spatial, libero_object, libero_goal, libero_10; others "
        "by --libero-tasks DIR. In the embedded suites recorded commands are played by `robostress "
        "sweep --policies replay`"));
  }
  return unit;
}

const char* NameOf(Stepping stepping) {
  switch (stepping) {
    case Stepping::kParity:
      return "parity";
    case Stepping::kReference:
      return "reference";
    default:
      return "fast";
  }
}

absl::Status RunReplay(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const UnitConfig unit, ResolvedUnit(line));
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(line.in));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<LiberoSimTask> task,
                      LiberoSimTask::Create(unit, line.task));
  RS_ASSIGN_OR_RETURN(const Recording recording, ReadRecording(file, *task));
  if (line.settle_steps >= recording.steps() && unit.scenario != "clean") {
    return absl::InvalidArgumentError(absl::StrCat("--settle-steps ", line.settle_steps,
                                                   " leaves none of the ", recording.steps(),
                                                   " actions of ", line.in, " to the scenario"));
  }
  SafetensorsWriter writer;
  RS_RETURN_IF_ERROR(Replay(recording, line.settle_steps, *task, writer));
  writer.SetMetadata("suite", unit.suite);
  writer.SetMetadata("task", absl::StrCat(line.task));
  writer.SetMetadata("scenario", unit.scenario);
  writer.SetMetadata("severity", absl::StrCat(unit.severity));
  UnitConfig sim_only = unit;
  sim_only.sim.settle_steps = line.settle_steps;
  writer.SetMetadata("sim", DumpConfig(sim_only.sim));
  RS_RETURN_IF_ERROR(writer.Write(line.out));
  std::printf("%s: %d control steps of %s task %d (%s), scenario %s, %s stepping\n",
              line.out.c_str(), recording.steps(), unit.suite.c_str(), line.task,
              task->name().c_str(), unit.scenario.c_str(), NameOf(unit.sim.stepping));
  return absl::OkStatus();
}

bool Asked(const CommandLine& line, const std::string& key) {
  if (line.keys.empty()) return true;
  return std::find(line.keys.begin(), line.keys.end(), key) != line.keys.end();
}

// True when everything that was asked for is within the tolerance.
absl::StatusOr<bool> RunCompare(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile a, SafetensorsFile::Open(line.compare[0]));
  RS_ASSIGN_OR_RETURN(const SafetensorsFile b, SafetensorsFile::Open(line.compare[1]));
  RS_ASSIGN_OR_RETURN(std::vector<TensorDifference> all, CompareTensors(a, b));
  std::vector<TensorDifference> differences;
  bool within = true;
  for (const TensorDifference& d : all) {
    if (!Asked(line, d.key)) continue;
    differences.push_back(d);
    const bool both = d.kind == TensorDifference::Kind::kEqualShape;
    if (line.tolerance >= 0 &&
        (both ? d.largest > line.tolerance
              : !line.keys.empty() || d.kind == TensorDifference::Kind::kShapes)) {
      within = false;
    }
  }
  for (const std::string& key : line.keys) {
    if (!a.tensors().contains(key) && !b.tensors().contains(key))
      return absl::NotFoundError(absl::StrCat("neither file has a tensor '", key, "'"));
  }
  std::printf("%s", ComparisonTable(differences).c_str());
  return within;
}

int Main(int argc, char** argv) {
  cli::App app("Plays recorded commands in a LIBERO task, or compares two such files.",
               "robostress replay");
  app.footer(kExamples);
  CommandLine line;
  line.unit.suite.clear();
  app.add_option("--suite", line.unit.suite,
                 "libero_spatial, libero_object, libero_goal or libero_10");
  app.add_option(
         "--libero-tasks", line.unit.libero_tasks,
         "Instead of --suite: a folder of LIBERO tasks (.bddl), in the order of their names")
      ->type_name("DIR")
      ->check(cli::ExistingDirectory());
  app.add_option("--task", line.task, "Index in the benchmark's order");
  app.add_option("--in", line.in, "Recording to play");
  app.add_option("--out", line.out, "File to write");
  app.add_option("--mode", line.mode, "parity: as the originals step; fast: as sweeps step")
      ->check(cli::IsMember({"parity", "fast"}))
      ->capture_default_str();
  app.add_option("--scenario", line.unit.scenario, "See `robostress scenarios`")
      ->capture_default_str();
  app.add_option("--severity", line.unit.severity, "Level 1 to 5")->capture_default_str();
  app.add_option("--settle-steps", line.settle_steps,
                 "The first N actions settle: a scenario's ramp starts after them")
      ->check(cli::NonNegativeNumber())
      ->capture_default_str();
  app.add_option("--set", line.overrides,
                 "KEY=VALUE of the simulator, such as robosuite.home_goal=false")
      ->allow_extra_args(false);
  app.add_option("--libero-root", line.unit.libero_root, "LIBERO checkout (or LIBERO_ROOT)");
  app.add_option("--robosuite-root", line.unit.robosuite_root,
                 "robosuite checkout (or ROBOSUITE_ROOT)");
  app.add_option("--compare", line.compare, "Print the largest difference per key of two files")
      ->expected(2);
  app.add_option("--keys", line.keys, "Compare only these");
  app.add_option("--tolerance", line.tolerance, "Exit with 1 when a difference is larger");
  return RunMain(
      app, argc, argv,
      [&]() -> absl::StatusOr<int> {
        if (!line.compare.empty()) {
          RS_ASSIGN_OR_RETURN(const bool within, RunCompare(line));
          return within ? 0 : 1;
        }
        const bool suite = !line.unit.suite.empty() || !line.unit.libero_tasks.empty();
        if (line.task < 0 && line.task != kNoTask) {
          return absl::InvalidArgumentError(
              absl::StrCat("--task ", line.task, " does not exist; tasks are counted from 0"));
        }
        if (!suite || line.task == kNoTask || line.in.empty() || line.out.empty()) {
          return absl::InvalidArgumentError(
              "give --suite or --libero-tasks, --task, --in and --out, or --compare A B; --help "
              "has examples");
        }
        RS_RETURN_IF_ERROR(RunReplay(line));
        return 0;
      },
      [](const absl::Status& status) {
        return absl::IsUnavailable(status) || absl::IsInternal(status) ? kFailed : kWrongCommand;
      });
}

}  // namespace
}  // namespace robostress::libero

int main(int argc, char** argv) { return robostress::libero::Main(argc, argv); }
