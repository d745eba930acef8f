// robot_client: runs an AgileX Piper, real or emulated, or an arm behind a driver process, against
// a policy server.

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/cameras_command.h"
#include "robot_client/client_program.h"
#include "robot_client/monitor_command.h"
#include "robot_client/motion_command.h"
#include "robot_client/teach_command.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  # a rehearsal: no arm, no camera, everything else as it will be
  robostress serve --policy nano-piper --listen 127.0.0.1:50051 &
  robot_client --server 127.0.0.1:50051 --policy nano-piper \
    --instruction "open the top drawer of the cabinet" \
    --camera base=synthetic --camera wrist=synthetic --out runs/rehearsal

  # an arm in software, then a real one: only --bus and the cameras change
  piper_emulator --bus udp:239.74.163.2:43113 --profile used_one_year &
  robot_client --config robot_client/lab.yaml --bus udp:239.74.163.2:43113 --set cameras=[] --out runs/emulated
  robot_client --config robot_client/lab.yaml --method ours --out runs/real

  # another arm, behind a driver process: LeRobot's SO-101 (docs/results/arm-bridge.md)
  python deploy/robostress_bridge_lerobot.py --socket /tmp/arm --robot.type=so101_follower --robot.port=/dev/ttyACM0 &
  robot_client --arm bridge:unix:/tmp/arm --robot robot_client/bridge/so101.yaml --out runs/so101

  robot_client monitor --bus can:can0     # looks at an arm without commanding it; monitor --help
  robot_client cameras                    # lists cameras, or shows them; cameras --help
  robot_client teach --help               # demonstrations by hand, leader arm, keyboard, gamepad
  robot_client replay --help              # plays what was recorded or demonstrated
  robot_client excite --help              # moves the arm so that it can be calibrated

The client starts in IDLE and moves nothing. Type `enable`, then `start`; Enter or Ctrl-C brakes and
holds, Ctrl-C again is the damped stop. docs/drive-an-arm.md is the first day step by step,
docs/results/arm-safety.md says what each stop does: read them first.

Exit codes: 0 the run was recorded whole; 1 it failed on the way; 2 bad input or nothing to connect to.
)";

struct CommandLine {
  ClientFlags client;
  std::string server, policy, instruction, method;
};

absl::StatusOr<ClientConfig> Resolve(const CommandLine& line) {
  return ResolveConfig(line.client, [&](ClientConfig& config) -> absl::Status {
    if (!line.method.empty()) {
      RS_ASSIGN_OR_RETURN(config.policy.method, MakeMethod(line.method));
    }
    const std::pair<const std::string*, std::string*> given[] = {
        {&line.server, &config.policy.server},
        {&line.policy, &config.policy.policy},
        {&line.instruction, &config.instruction}};
    for (const auto& [from, to] : given) {
      if (!from->empty()) *to = *from;
    }
    return absl::OkStatus();
  });
}

// Every episode, one after the other; nothing is resumed or cleared.
std::optional<OperatorOrder> NextOrder(const ClientRun& run) {
  if (run.done()) return OperatorOrder{OperatorCommand::kQuit};
  if (run.state() == ClientState::kIdle) return OperatorOrder{OperatorCommand::kEnable};
  if (run.state() == ClientState::kEnabled && !run.episode_running())
    return OperatorOrder{OperatorCommand::kStart};
  return std::nullopt;
}

absl::Status Run(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const ClientConfig config, Resolve(line));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<ClientRun> run,
                      ClientRun::Create(config, line.client.out));
  return RunConsole(*run, line.client.automatic ? NextOrder : AutomaticOrder());
}

int Main(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "";
  if (command == "cameras") return CamerasMain(argc - 1, argv + 1);
  if (command == "monitor") return MonitorMain(argc - 1, argv + 1);
  if (command == "replay") return ReplayMain(argc - 1, argv + 1);
  if (command == "excite") return ExciteMain(argc - 1, argv + 1);
  if (command == "teach") return TeachMain(argc - 1, argv + 1);
  cli::App app(
      "Runs an AgileX Piper, or an arm behind a driver process, at 30 Hz against a policy server "
      "and records every tick.",
      "robot_client");
  app.footer(kExamples);
  CommandLine line;
  AddClientFlags(app, line.client);
  app.add_option("--server", line.server, "HOST:PORT of the policy server");
  app.add_option("--policy", line.policy, "policy that the server holds");
  app.add_option("--method", line.method, "base, ours, ... as in a sweep");
  app.add_option("--instruction", line.instruction, "what the policy is told");
  return RunMain(
      app, argc, argv, [&] { return Run(line); }, ClientExitCode);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
