// robostress-piper-worker: runs one unit of a sweep of robot piper, or records the demonstrations
// that its policies are trained on.

#include <cstdio>
#include <filesystem>
#include <string>
#include <string_view>

#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/study/demonstration_recorder.h"
#include "robot_client/study/live_player.h"
#include "robot_client/study/piper_player.h"
#include "robot_client/study/table_suites.h"

namespace robostress::piper {
namespace {

constexpr char kExamples[] = R"(
Examples
  robostress piper-worker list                                  tasks, instructions, object variants
  robostress piper-worker record --arm new --task bowl_on_box --out data/new_bowl_on_box.safetensors
  robostress piper-worker --unit unit.yaml --server 127.0.0.1:50051 --out runs/unit

`robostress sweep` and `robostress piper-study` plan and start these. Exit codes: 0 done; 1 failed on the way; 2 bad
input.
)";

struct CommandLine {
  std::string arm = "new", task = kTableTasks[0].name, out, unit, server;
  RecorderOptions recorder;
  UnitRunOptions run;
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

absl::Status PlayUnit(const CommandLine& line) {
  if (line.unit.empty() || line.run.out.empty() || line.server.empty())
    return absl::InvalidArgumentError("--unit, --server and --out are needed to run a unit");
  RS_ASSIGN_OR_RETURN(const std::string yaml, ReadFile(line.unit));
  RS_ASSIGN_OR_RETURN(const UnitConfig read, ReadUnit(line.unit, yaml));
  RS_ASSIGN_OR_RETURN(const UnitConfig unit, ResolvePiperUnit(read));
  if (unit.client.real_time) {
    const std::string folder = std::filesystem::absolute(line.run.out).lexically_normal().string();
    RS_ASSIGN_OR_RETURN(const auto player, LivePlayer::Create(unit, line.server, folder));
    return RunUnit(unit, line.run, *player);
  }
  PolicyConnectionOptions session = SessionOf(unit, line.server);
  session.connect_timeout_s = 60;
  session.call_timeout_s = 300;
  session.mode = ExecutionMode::kLockstep;
  PiperPlayer player(unit, ConnectTo(session, 1 / ControlOptions().rate_hz));
  return RunUnit(unit, line.run, player);
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
  cli::App app("Runs one unit of a sweep on an emulated Piper, or records demonstrations.",
               "robostress piper-worker");
  app.footer(kExamples);
  app.require_subcommand(0, 1);
  CommandLine line;
  cli::App* const list = app.add_subcommand("list", "Tasks and object variants");
  cli::App* const record = app.add_subcommand("record", "Demonstrations of the scripted expert");
  record->add_option("--arm", line.arm, "Wear profile")->capture_default_str();
  record->add_option("--task", line.task, "One of the four")->capture_default_str();
  record->add_option("--episodes", line.recorder.episodes, "Successful ones")
      ->check(cli::Range(1, 1000))
      ->capture_default_str();
  record->add_option("--out", line.out, "Shard (.safetensors)")->required();
  app.add_option("--unit", line.unit, "unit configuration (YAML)");
  app.add_option("--server", line.server, "HOST:PORT of a policy server");
  app.add_option("--out", line.run.out, "directory to write");
  bool quiet = false;
  app.add_flag("--quiet", quiet, "no progress lines");
  return RunMain(
      app, argc, argv,
      [&] {
        if (!quiet) {
          line.run.progress = [](std::string_view text) {
            std::printf("%.*s\n", static_cast<int>(text.size()), text.data());
            std::fflush(stdout);
          };
        }
        return list->parsed() ? List() : record->parsed() ? Record(line) : PlayUnit(line);
      },
      [](const absl::Status& status) {
        return absl::IsInvalidArgument(status) || absl::IsNotFound(status) ||
                       absl::IsFailedPrecondition(status) || absl::IsUnimplemented(status)
                   ? kWrongCommand
                   : kFailed;
      });
}

}  // namespace
}  // namespace robostress::piper

int main(int argc, char** argv) { return robostress::piper::Main(argc, argv); }
