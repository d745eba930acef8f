#include "robot_client/teach_command.h"

#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/client_program.h"
#include "robot_client/teach_run.h"

namespace robostress {
namespace {

constexpr char kTeachHelp[] =
    "Orders, one a line; Enter or Ctrl-C brakes and holds\n"
    "  record      begin a demonstration        discard   drop it\n"
    "  success     end and save it              failure   end it; dropped, or --keep-failures\n"
    "  quit        leave; the arm keeps its power and holds\n"
    "Not by hand:\n"
    "  enable      give the joints power; the arm holds where it is\n"
    "  follow      the arm follows leader, keyboard or gamepad, to a leader slowly at first\n"
    "  home        drive to the configured pose  jog J2 5deg   move one joint, slowly\n"
    "  end         after HOLD: the arm stands    clear   leave FAULT, then enable again\n"
    "  stop        or Ctrl-C again within 3 s: damped stop, the arm SINKS\n";

constexpr char kExamples[] = R"(Examples:
  # the person moves the arm in its own teaching mode; nothing is sent to it
  robot_client teach --by hand --bus can:can0 --config lab.yaml --out data/drawer \
    --instruction "open the top drawer"
  # a second Piper leads, on a bus of its own
  robot_client teach --by leader:can:can1 --bus can:can0 --config lab.yaml --out data/drawer \
    --instruction "open the top drawer"
  # keys, or a gamepad whose left shoulder button is held
  robot_client teach --by keyboard --bus udp:239.74.163.2:43113 --config lab.yaml --out data/drawer \
    --instruction "open the top drawer"

--out gets lerobot/, shards/ and libero/, and goes on where it was; runs/NNN in it holds every tick.
Then: robostress train --data data/drawer/shards ... (docs/teach-and-record.md).

Exit codes: 0 the run ended well; 1 it failed on the way; 2 bad input or nothing to connect to.
)";

struct CommandLine {
  ClientFlags client;
  std::string by = "hand", instruction;
  double speed = 0.1;
  bool keep_failures = false;
};

absl::Status Run(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(ClientConfig config, ResolveConfig(line.client, [&](ClientConfig& changed) {
                        if (!line.instruction.empty()) changed.instruction = line.instruction;
                        return absl::OkStatus();
                      }));
  if (line.client.automatic)
    return absl::InvalidArgumentError("--automatic: a person teaches; leave it out");
  TeachOptions options;
  RS_RETURN_IF_ERROR(ParseTeachBy(line.by, &options));
  options.directory = line.client.out;
  options.tool_velocity = line.speed;
  options.keep_failures = line.keep_failures;
  OperatorConsole console;
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<TeachRun> teach,
                      TeachRun::Create(std::move(config), options, &console));
  teach->Say(teach->description());
  teach->Say(kTeachHelp);
  teach->StartThreads();
  const auto tell = [&](const absl::StatusOr<std::string>& answer) {
    if (!answer.ok()) teach->Say(absl::StrCat("refused: ", answer.status().message()));
    if (answer.ok() && !answer->empty()) teach->Say(*answer);
  };
  while (true) {
    const std::optional<OperatorOrder> order = console.Next(20, teach->busy());
    if (const std::string complaint = console.TakeComplaint(); !complaint.empty())
      teach->Say(complaint);
    // Nobody can type any more: what is being saved is saved, then the arm holds.
    const bool ends = console.input_ended() && !order && !teach->busy();
    if (ends || (order && (order->command == OperatorCommand::kQuit ||
                           order->command == OperatorCommand::kQuitLimp)))
      return teach->Finish(order && order->command == OperatorCommand::kQuitLimp);
    if (order) tell(teach->Act(*order));
    tell(teach->Watch());
  }
}

}  // namespace

int TeachMain(int argc, char** argv) {
  cli::App app("Records demonstrations of a person: by hand, leader arm, keyboard or gamepad.",
               "robot_client teach");
  app.footer(kExamples);
  CommandLine line;
  app.add_option("--by", line.by, "hand, leader:BUS, keyboard or gamepad[:/dev/input/js0]")
      ->capture_default_str();
  app.add_option("--instruction", line.instruction, "what is being done, in words");
  AddClientFlags(app, line.client);
  app.add_option("--speed", line.speed, "of the tool by keyboard or gamepad [m/s]")
      ->capture_default_str();
  app.add_flag("--keep-failures", line.keep_failures, "keep failures too, in lerobot/ alone");
  return RunMain(
      app, argc, argv, [&] { return Run(line); }, ClientExitCode);
}

}  // namespace robostress
