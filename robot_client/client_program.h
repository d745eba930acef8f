#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/command_line.h"
#include "robot_client/client_config.h"
#include "robot_client/client_run.h"
#include "robot_client/operator_console.h"

namespace robostress {

// What every command says that moves an arm: which arm, how it is configured, where it is recorded.
struct ClientFlags {
  std::string config_file, out, bus, robot;
  std::vector<std::string> cameras, overrides, without;
  bool automatic = false;
};
void AddClientFlags(cli::App& app, ClientFlags& flags);

// The robot file's defaults, the configuration file, the flags, `change` and --set, each field by
// field over those before. `change` is called twice.
absl::StatusOr<ClientConfig> ResolveConfig(
    const ClientFlags& flags, const std::function<absl::Status(ClientConfig&)>& change =
                                  [](ClientConfig&) { return absl::OkStatus(); });

// What a person would type next for a whole run without trouble; nothing: wait.
using AutomaticOrder = std::function<std::optional<OperatorOrder>(const ClientRun&)>;

// Obeys the console until it quits, then finishes the run. With `automatic` nobody is there: the
// first order that is refused, or a FAULT, ends the run and is its error.
absl::Status RunConsole(ClientRun& run, const AutomaticOrder& automatic);

// The exit code of an error, for RunMain: 2 bad input or nothing to connect to, 1 all else.
int ClientExitCode(const absl::Status& status);

}  // namespace robostress
