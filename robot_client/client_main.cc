// robot_client: runs an AgileX Piper, real or emulated, against a policy server.

#include <cstdio>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "robot_client/cameras_command.h"
#include "robot_client/client_run.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  # a rehearsal: no arm, no camera, everything else as it will be
  robostress serve --policy CHECKPOINT --listen 127.0.0.1:50051 &
  robot_client --server 127.0.0.1:50051 --policy CHECKPOINT --instruction "open the top drawer" \
    --camera base=synthetic --camera wrist=synthetic --out runs/rehearsal

  # an arm in software, then a real one: only --bus and the cameras change
  piper_emulator --bus udp:239.74.163.2:43113 --profile used_one_year &
  robot_client --bus udp:239.74.163.2:43113 --config lab.yaml --out runs/emulated
  robot_client --bus can:can0 --config lab.yaml --method ours --set control.observer=true --out runs/real

The client starts in IDLE and moves nothing. Type `enable`, then `start`; Enter or Ctrl-C brakes and
holds, Ctrl-C again is the damped stop. robot_client/README.md says what each stop does: read it first.

Exit codes: 0 the run was recorded whole; 1 it failed on the way; 2 bad input or nothing to connect to.
)";

struct CommandLine {
  std::string config_file, out, server, policy, bus, instruction, method;
  std::vector<std::string> cameras, overrides, without;
  bool automatic = false;
};

absl::StatusOr<ClientConfig> Resolve(const CommandLine& line) {
  ClientConfig config;
  if (!line.config_file.empty()) {
    RS_ASSIGN_OR_RETURN(config, LoadConfig<ClientConfig>(line.config_file));
  }
  if (!line.method.empty()) {
    RS_ASSIGN_OR_RETURN(config.policy.method, MakeMethod(line.method));
  }
  const std::pair<const std::string*, std::string*> given[] = {
      {&line.server, &config.policy.server},
      {&line.policy, &config.policy.policy},
      {&line.bus, &config.bus},
      {&line.instruction, &config.instruction}};
  for (const auto& [from, to] : given) {
    if (!from->empty()) *to = *from;
  }
  if (!line.cameras.empty()) config.cameras = line.cameras;
  if (!line.without.empty()) config.without = line.without;
  RS_RETURN_IF_ERROR(ApplyOverrides(line.overrides, config));
  if (line.automatic && absl::StartsWith(config.bus, "can:") &&
      !absl::StartsWith(config.bus, "can:vcan")) {
    return absl::InvalidArgumentError(
        absl::StrCat("--automatic with --bus ", config.bus,
                     ": a real arm is enabled and started by a person; leave --automatic out"));
  }
  return config;
}

// What a person would type for a whole run without trouble; nothing is resumed or cleared.
std::optional<OperatorCommand> AutomaticCommand(const ClientRun& run) {
  if (run.busy()) return std::nullopt;
  if (run.done()) return OperatorCommand::kQuit;
  switch (run.state()) {
    case ClientState::kIdle:
      return OperatorCommand::kEnable;
    case ClientState::kEnabled:
      return run.episode_running() ? std::nullopt : std::optional(OperatorCommand::kStart);
    case ClientState::kFault:
      return OperatorCommand::kQuit;
    default:
      return std::nullopt;
  }
}

absl::Status Run(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const ClientConfig config, Resolve(line));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<ClientRun> run, ClientRun::Create(config, line.out));
  OperatorConsole console;
  run->Say(run->description());
  if (!line.automatic) run->Say(kOperatorHelp);
  run->StartThreads();
  absl::Status refused;  // without a person nobody reads why, so the exit code says it
  const auto tell = [&](const absl::StatusOr<std::string>& answer) {
    if (!answer.ok()) {
      run->Say(absl::StrCat("refused: ", answer.status().message()));
      if (refused.ok()) refused = answer.status();
    } else if (!answer->empty()) {
      run->Say(*answer);
    }
  };
  std::optional<OperatorCommand> quit;
  while (!quit) {
    std::optional<OperatorOrder> order = console.Next(20, run->busy());
    if (const std::string complaint = console.TakeComplaint(); !complaint.empty())
      run->Say(complaint);
    if (!order && line.automatic) {
      if (const auto command = AutomaticCommand(*run)) order = OperatorOrder{*command};
    }
    if (order && (order->command == OperatorCommand::kQuit ||
                  order->command == OperatorCommand::kQuitLimp)) {
      quit = order->command;
    } else if (order) {
      tell(run->Act(*order));
    }
    tell(run->Watch());
    if (line.automatic && !refused.ok()) quit = OperatorCommand::kQuit;
  }
  if (!line.automatic) refused = absl::OkStatus();  // a person has read it
  if (line.automatic && run->state() == ClientState::kFault && refused.ok())
    refused = absl::AbortedError("the run ended in FAULT; events.jsonl says why");
  RS_RETURN_IF_ERROR(run->Finish(quit == OperatorCommand::kQuitLimp));
  return refused;
}

int ExitCode(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return 0;
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kNotFound:
    case absl::StatusCode::kAlreadyExists:
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kUnavailable:
      return 2;
    default:
      return 1;
  }
}

int Main(int argc, char** argv) {
  if (argc > 1 && std::string(argv[1]) == "cameras") return CamerasMain(argc - 1, argv + 1);
  CLI::App app("Runs an AgileX Piper at 30 Hz against a policy server and records every tick.",
               "robot_client");
  app.footer(kExamples);
  CommandLine line;
  app.add_option("--config", line.config_file, "configuration (YAML), as a run writes it");
  app.add_option("--out", line.out, "directory of the recording; must not hold one")->required();
  app.add_option("--server", line.server, "HOST:PORT of the policy server");
  app.add_option("--policy", line.policy, "policy that the server holds");
  app.add_option("--method", line.method, "base, ours, ... as in a sweep");
  app.add_option("--bus", line.bus, "can:can0, udp:GROUP:PORT, or rehearse (no arm; default)");
  app.add_option("--instruction", line.instruction, "what the policy is told");
  app.add_option("--camera", line.cameras,
                 "NAME=v4l2:DEVICE[@WxH] | NAME=files:DIR | NAME=mapped:FILE | NAME=synthetic, "
                 "each with an optional "
                 ",fault=KIND[:AMOUNT][@SECONDS]; in the policy's order, repeatable")
      ->allow_extra_args(false);
  app.add_option("--set", line.overrides, "key.key=value over the configuration, repeatable")
      ->allow_extra_args(false);
  app.add_option("--without", line.without,
                 "a watchdog that is given up (the name of its option under control.watchdogs): it "
                 "may have a value that guards nothing; repeatable")
      ->allow_extra_args(false);
  app.add_flag("--automatic", line.automatic,
               "enable, run every episode and quit without a person; not on a real bus");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const absl::Status status = Run(line);
  if (!status.ok())
    std::fprintf(stderr, "robot_client: %s\n", std::string(status.message()).c_str());
  return ExitCode(status);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
