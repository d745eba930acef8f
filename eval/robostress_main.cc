// robostress COMMAND [arguments]: runs robostress-COMMAND, in the manner of git.

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/option_table.h"
#include "common/program_folder.h"
#include "common/run_main.h"
#include "common/version.h"
#include "eval/launch/server_process.h"
#include "eval/plan/build_info.h"

namespace {

struct Command {
  const char* name;
  const char* summary;
  const char* needs = "";  // options of CMake that leave it out when one is off
};

// What the help lists; a program robostress-X that is not here runs too.
constexpr Command kCommands[] = {
    {"sweep", "Evaluate policies and methods over suites and scenarios, then report"},
    {"report", "Write the report page and tables of a run directory"},
    {"compare", "Put results of several laboratories beside each other"},
    {"store", "Check, merge and index run directories"},
    {"grid-job", "Run one job of a grid that a scheduler distributes", "ROBOSTRESS_CLUSTER"},
    {"residual", "Measure residual magnitudes for both goal references, and their controller lag"},
    {"paper", "One table of the paper: planned, run and laid out beside the published numbers"},
    {"calibrate", "Find what a model of a measured robot lacks, add it, report before and after",
     "ROBOSTRESS_MUJOCO"},
    {"fidelity", "Compare Heavy Payload and Gaussian action noise with a real payload",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"suites", "List suites, their tasks and instructions; draw their first frames",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"libero", "Find, check and remember LIBERO's own files",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_LIBERO"},
    {"scenarios", "List scenarios with their severity factors"},
    {"error-models", "Draw the four joint error models over time"},
    {"serve", "Serve a policy, with online adaptation, over gRPC", "ROBOSTRESS_TORCH"},
    {"proxy", "Correct a robot's commands between its client and somebody else's policy server"},
    {"sessions", "List a running server's sessions; export, pin, roll back their adapters"},
    {"policy", "Inspect a policy; check a pi0 or pi0.5 checkpoint against expected values",
     "ROBOSTRESS_TORCH"},
    {"tokenize", "Tokenise text with a SentencePiece model", "ROBOSTRESS_TORCH ROBOSTRESS_OPENPI"},
    {"worker", "Run one unit of a sweep: the simulator's side",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"environment", "Let another program play one task of a suite",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"piper-worker", "Run one unit of a sweep of robot piper; record its demonstrations",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_ROBOT_CLIENT"},
    {"export", "Write a run's recorded episodes as data sets for training"},
    {"record", "Record demonstrations of the scripted experts",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"train", "Train the embedded policy from demonstrations", "ROBOSTRESS_TORCH"},
    {"excite", "Design the motion that tells what a robot's model lacks", "ROBOSTRESS_MUJOCO"},
    {"log", "Say what a recording of an arm holds; write its first rig for calibrate",
     "ROBOSTRESS_MUJOCO"},
    {"urdf", "Write an MJCF model as URDF, which robot_client reads", "ROBOSTRESS_MUJOCO"},
    {"record-to-rig", "Turn a recorded run into a rig with logs for calibrate",
     "ROBOSTRESS_MUJOCO"},
    {"close-loop", "Hide errors in the simulated arm, find them from its logs, compare",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"identify", "Find joint errors of simulated arms from their own first episodes",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_SUITES"},
    {"piper-study", "The paper's real-arm experiments on emulated Pipers, from recording to report",
     "ROBOSTRESS_ROBOT_CLIENT"},
    {"replay", "Play recorded commands in a LIBERO task, compare two recordings",
     "ROBOSTRESS_MUJOCO ROBOSTRESS_LIBERO"},
};

// "ROBOSTRESS_LIBERO=OFF": why this build has no such program; empty where its options are on.
std::string WhyLeftOut(const Command& command) {
  const std::vector<std::string> off = absl::StrSplit(robostress::kLeftOut, ' ', absl::SkipEmpty());
  for (const auto option : absl::StrSplit(command.needs, ' ', absl::SkipEmpty())) {
    if (std::find(off.begin(), off.end(), option) != off.end()) return absl::StrCat(option, "=OFF");
  }
  return "";
}

constexpr char kPurpose[] =
    "Stress-tests vision-language-action policies under joint-level execution errors and "
    "measures what\n"
    "online self-compensation wins back.";

constexpr char kExamples[] =
    "Examples\n"
    "  robostress sweep --quick --out runs/quick        one suite, base and self-compensating, "
    "two workers\n"
    "  robostress report runs/quick                     the report again, from the recorded "
    "episodes\n"
    "  robostress scenarios                             what each scenario does to each joint\n"
    "  robostress COMMAND --help                        every option of a command\n\n"
    "Programs are looked for beside this one, or in ROBOSTRESS_BIN.";

// Commands as those of a command line, for the manual page and completion.
void PrintOptionTable() {
  robostress::cli::App app(kPurpose, "robostress");
  app.footer(kExamples);
  app.set_version_flag("--version", robostress::VersionText(), "Print the version and exit");
  for (const Command& command : kCommands)
    app.add_subcommand(command.name, command.summary)->set_help_flag();  // its own table has it
  std::printf("%s\n", robostress::OptionTableText(app).c_str());
}

void PrintHelp() {
  std::printf("Usage: robostress COMMAND [options]\n\n%s\n\nCommands\n", kPurpose);
  const std::vector<std::string> installed = robostress::InstalledCommands();
  for (const Command& command : kCommands) {
    const bool here =
        std::find(installed.begin(), installed.end(), command.name) != installed.end();
    const std::string why = WhyLeftOut(command);
    const std::string missing =
        here ? "" : absl::StrCat("  (not in this build", why.empty() ? "" : ": ", why, ")");
    std::printf("  %-13s %s%s\n", command.name, command.summary, missing.c_str());
  }
  for (const std::string& name : installed) {
    const bool listed = std::any_of(std::begin(kCommands), std::end(kCommands),
                                    [&](const Command& command) { return name == command.name; });
    if (!listed) std::printf("  %-13s see `robostress %s --help`\n", name.c_str(), name.c_str());
  }
  std::printf("\n%s Version %s.\n", kExamples, robostress::BuildVersion());
}

}  // namespace

int main(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "--help";
  if (command == "--help" || command == "-h" || command == "help") {
    PrintHelp();
    return 0;
  }
  if (command == "--version") {
    std::printf("robostress %s\n", robostress::VersionText().c_str());
    return 0;
  }
  if (command == robostress::kOptionTableFlag) {
    PrintOptionTable();
    return 0;
  }
  const absl::StatusOr<std::string> program = robostress::FindProgram(command);
  if (!program.ok()) {
    std::string message(program.status().message());
    for (const Command& known : kCommands) {
      if (const std::string why = WhyLeftOut(known); command == known.name && !why.empty())
        message = absl::StrCat("this build has no command ", command, ": it was configured with ",
                               why, "; configure it with that option ON and build again");
    }
    std::fprintf(stderr, "robostress: %s\nSee `robostress --help`.\n", message.c_str());
    return 2;
  }
  robostress::ChooseOpenMpBlas();
  std::vector<char*> arguments(argv + 1, argv + argc);
  arguments[0] = const_cast<char*>(program->c_str());
  arguments.push_back(nullptr);
  execv(program->c_str(), arguments.data());
  std::perror(program->c_str());
  return 126;
}
