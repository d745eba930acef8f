// piper_study_worker: the arm's side of `robostress piper-study`: records demonstrations of one arm
// and task, or lets a served policy play one unit of the evaluation, in simulated time.

#include <cstdio>
#include <string>

#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/emulator/study/demonstration_recorder.h"
#include "robot_client/emulator/study/study_unit.h"

namespace robostress::piper {
namespace {

constexpr char kExamples[] = R"(
Examples
  piper_study_worker list                                       tasks, instructions, object variants
  piper_study_worker record --arm new --task bowl_on_box --out data/new_bowl_on_box.safetensors
  piper_study_worker evaluate --unit unit.yaml --server 127.0.0.1:50051 --out runs/unit

`robostress piper-study` plans and starts these. Exit codes: 0 done; 1 failed on the way; 2 bad input.
)";

struct CommandLine {
  std::string arm = "new", task = kTableTasks[0].name, out, unit, server;
  RecorderOptions recorder;
};

absl::Status Record(const CommandLine& line) {
  StudyBenchOptions bench;
  bench.arm = line.arm;
  RS_ASSIGN_OR_RETURN(bench.task, FindTableTask(line.task));
  RS_RETURN_IF_ERROR(MakeWearProfile(line.arm).status());
  RS_ASSIGN_OR_RETURN(const auto recorder, DemonstrationRecorder::Create(line.recorder, bench));
  RS_RETURN_IF_ERROR(recorder->Record(line.out));
  std::printf("%s, arm %s: %d demonstrations of %d attempts -> %s\n", line.task.c_str(),
              line.arm.c_str(), recorder->successes(), recorder->attempts(), line.out.c_str());
  return absl::OkStatus();
}

absl::Status Evaluate(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const StudyUnit unit, LoadConfig<StudyUnit>(line.unit));
  return RunStudyUnitTo(unit, line.server, line.out);
}

absl::Status List() {
  RS_ASSIGN_OR_RETURN(const ArmVector home, TableExpert::Home());
  std::printf("home %s\n", absl::StrJoin(home, ", ").c_str());
  for (const TableTask& task : kTableTasks)
    std::printf("task    %-20s %s\n", task.name, task.instruction);
  for (const ObjectVariant& variant : kObjectVariants)
    std::printf("variant %-20s %s\n", variant.name, variant.instruction);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Records demonstrations and evaluates policies on an emulated Piper.",
               "piper_study_worker");
  app.footer(kExamples);
  app.require_subcommand(1);
  CommandLine line;
  CLI::App* const list = app.add_subcommand("list", "Tasks and object variants");
  CLI::App* const record = app.add_subcommand("record", "Demonstrations of the scripted expert");
  record->add_option("--arm", line.arm, "Wear profile")->capture_default_str();
  record->add_option("--task", line.task, "One of the four")->capture_default_str();
  record->add_option("--episodes", line.recorder.episodes, "Successful ones")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  record->add_option("--out", line.out, "Shard (.safetensors)")->required();
  CLI::App* const evaluate = app.add_subcommand("evaluate", "One unit against a policy server");
  evaluate->add_option("--unit", line.unit, "Its configuration (YAML)")->required();
  evaluate->add_option("--server", line.server, "HOST:PORT")->required();
  evaluate->add_option("--out", line.out, "Directory of its results")->required();
  return RunMain(
      app, argc, argv,
      [&] { return list->parsed()     ? List()
                   : record->parsed() ? Record(line)
                                      : Evaluate(line); },
      [](const absl::Status& status) {
        return absl::IsInvalidArgument(status) || absl::IsNotFound(status) ? kWrongCommand
                                                                           : kFailed;
      });
}

}  // namespace
}  // namespace robostress::piper

int main(int argc, char** argv) { return robostress::piper::Main(argc, argv); }
