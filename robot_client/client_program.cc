#include "robot_client/client_program.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"

namespace robostress {

void AddClientFlags(cli::App& app, ClientFlags& flags) {
  app.add_option("--config", flags.config_file, "configuration (YAML), as a run writes it");
  app.add_option("--out", flags.out, "directory of the recording; must not hold one")->required();
  app.add_option("--bus,--arm", flags.bus,
                 "can:can0, udp:GROUP:PORT, bridge:unix:SOCKET, or rehearse (no arm; default)");
  app.add_option("--robot", flags.robot,
                 "what is behind a bridge (YAML), for one robot_client/bridge/so101.yaml");
  app.add_option("--camera", flags.cameras,
                 "NAME=v4l2:DEVICE[@WxH] | NAME=files:DIR | NAME=mapped:FILE | NAME=synthetic, "
                 "each with an optional "
                 ",fault=KIND[:AMOUNT][@SECONDS]; in the policy's order, repeatable")
      ->allow_extra_args(false);
  app.add_option("--set", flags.overrides, "key.key=value over the configuration, repeatable")
      ->allow_extra_args(false);
  app.add_option("--without", flags.without,
                 "a guard that is given up (the name of its option under control.watchdogs or "
                 "control.press): it may have a value that guards nothing; repeatable")
      ->allow_extra_args(false);
  app.add_flag("--automatic", flags.automatic,
               "do all of it without a person and quit; not on a real bus");
}

namespace {

// What the configuration file, the flags, `change` and --set say, in this order, over `config`.
absl::Status ReadOver(const ClientFlags& flags,
                      const std::function<absl::Status(ClientConfig&)>& change,
                      ClientConfig& config) {
  if (!flags.config_file.empty()) {
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(flags.config_file));
    RS_ASSIGN_OR_RETURN(const YAML::Node root, config_internal::ParseYaml(flags.config_file, text));
    ConfigReader reader(flags.config_file, root);
    config.Visit(reader);
    RS_RETURN_IF_ERROR(reader.Finish());
  }
  if (!flags.bus.empty()) config.bus = flags.bus;
  if (!flags.robot.empty()) config.robot = flags.robot;
  if (!flags.cameras.empty()) config.cameras = flags.cameras;
  if (!flags.without.empty()) config.without = flags.without;
  RS_RETURN_IF_ERROR(change(config));
  return ApplyOverrides(flags.overrides, config);
}

}  // namespace

// Read twice: only all of it says which robot file the defaults are of.
absl::StatusOr<ClientConfig> ResolveConfig(
    const ClientFlags& flags, const std::function<absl::Status(ClientConfig&)>& change) {
  ClientConfig named, config;
  RS_RETURN_IF_ERROR(ReadOver(flags, change, named));
  config.bus = named.bus;
  config.robot = named.robot;
  RS_RETURN_IF_ERROR(TakeRobotFile(config));
  RS_RETURN_IF_ERROR(ReadOver(flags, change, config));
  RS_ASSIGN_OR_RETURN(const bool real, IsReal(config));
  if (flags.automatic && real) {
    return absl::InvalidArgumentError(
        absl::StrCat("--automatic with --bus ", config.bus,
                     ": a real arm is enabled and started by a person; leave --automatic out"));
  }
  return config;
}

absl::Status RunConsole(ClientRun& run, const AutomaticOrder& automatic) {
  OperatorConsole console;
  run.Say(run.description());
  if (!automatic) run.Say(kOperatorHelp);
  run.StartThreads();
  absl::Status refused;  // without a person nobody reads why, so the exit code says it
  const auto tell = [&](const absl::StatusOr<std::string>& answer) {
    if (!answer.ok()) {
      run.Say(absl::StrCat("refused: ", answer.status().message()));
      if (refused.ok()) refused = answer.status();
    } else if (!answer->empty()) {
      run.Say(*answer);
    }
  };
  std::optional<OperatorCommand> quit;
  while (!quit) {
    std::optional<OperatorOrder> order = console.Next(20, run.busy());
    if (const std::string complaint = console.TakeComplaint(); !complaint.empty())
      run.Say(complaint);
    if (!order && automatic && !run.busy()) {
      order = run.state() == ClientState::kFault ? OperatorOrder{OperatorCommand::kQuit}
                                                 : automatic(run);
    }
    if (order && (order->command == OperatorCommand::kQuit ||
                  order->command == OperatorCommand::kQuitLimp)) {
      quit = order->command;
    } else if (order) {
      tell(run.Act(*order));
    }
    tell(run.Watch());
    if (automatic && !refused.ok()) quit = OperatorCommand::kQuit;
  }
  if (!automatic) refused = absl::OkStatus();  // a person has read it
  if (automatic && run.state() == ClientState::kFault && refused.ok())
    refused = absl::AbortedError("the run ended in FAULT; events.jsonl says why");
  RS_RETURN_IF_ERROR(run.Finish(quit == OperatorCommand::kQuitLimp));
  return refused;
}

int ClientExitCode(const absl::Status& status) {
  switch (status.code()) {
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

}  // namespace robostress
