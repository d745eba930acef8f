#include "robot_client/motion_command.h"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/program_folder.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/client_program.h"
#include "robot_client/motion/excitation.h"
#include "robot_client/motion/motion_file.h"
#include "robot_client/piper/protocol.h"

namespace robostress {
namespace {

constexpr char kReplayExamples[] = R"(Examples:
  robot_client replay runs/tuesday --episode 3 --config lab.yaml --bus can:can0 --out runs/replayed
  robot_client replay data/drawer --episode 0 --config lab.yaml --bus can:can0 --out runs/replayed
  robot_client replay motion.csv --bus rehearse --out runs/rehearsed --automatic

SOURCE is a run's folder (what was sent), a data set that robot_client recorded (its actions), or a CSV with
columns t [s], q_cmd_J1, q_cmd_J2 .. [rad] or q_cmd_NAME by the joints' names in a rig, q_cmd_gripper [m]. Type `enable`, then `play slow`: the arm goes to the
first pose, no faster than home_velocity, and plays a quarter as fast. Then `play`, or `play 0.5`.
)";

constexpr char kExciteExamples[] = R"(Examples:
  robot_client excite --config lab.yaml --bus can:can0 --out runs/tuesday
  robot_client excite --motion motion.csv --config lab.yaml --bus can:can0 --out runs/tuesday
  robostress calibrate --rig runs/tuesday/rig/rig.yaml --out found --map own

Without --motion one is designed around `home` of the configuration, as large as joints' limits and workspace allow:
every joint alone at three speeds, then all together. Type `enable`, then `play slow`, then `play`, then `quit`:
OUT/rig is what `robostress calibrate` reads. Nothing may be in the gripper that --payload-kg is not told of, and
nothing in the arm's way.
)";

// Around which the arm moves where no home is configured: above the table, elbow bent.
constexpr ArmVector kCentre = {0, 1.0, -0.9, 0, 0.4, 0, 0.03};

struct CommandLine {
  ClientFlags client;
  std::string source;
  std::optional<int> episode;
  ExcitationOptions excitation;
  double payload_kg = 0;
};

// enable, play slow, play, quit.
std::optional<OperatorOrder> NextOrder(const ClientRun& run) {
  if (run.fastest_played() == 1) return OperatorOrder{OperatorCommand::kQuit};
  if (run.state() == ClientState::kIdle) return OperatorOrder{OperatorCommand::kEnable};
  if (run.state() != ClientState::kEnabled) return std::nullopt;
  OperatorOrder order{OperatorCommand::kPlay};
  order.amount = run.fastest_played() == 0 ? kSlowly : 1;
  return order;
}

// `played`: whether the motion was played to its end, at whatever speed.
absl::Status PlayInRun(const CommandLine& line, const ClientConfig& config,
                       const ClientRun::MotionMaker& motion, bool* played) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<ClientRun> run,
                      ClientRun::Create(config, line.client.out, motion));
  const absl::Status status =
      RunConsole(*run, line.client.automatic ? NextOrder : AutomaticOrder());
  *played = run->fastest_played() > 0;
  return status;
}

// No policy, no pictures: what is played was decided before.
absl::Status WithoutPolicy(ClientConfig& config) {
  config.policy.server.clear();
  config.cameras.clear();
  return absl::OkStatus();
}

absl::Status Replay(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const ClientConfig config, ResolveConfig(line.client, WithoutPolicy));
  RS_ASSIGN_OR_RETURN(const ArmAxes axes, AxesOf(config));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, RigNamesOf(config));
  RS_ASSIGN_OR_RETURN(const Motion motion, ReadMotion(line.source, line.episode, axes, names));
  bool played = false;
  return PlayInRun(
      line, config, [&](const ArmLimits&, const ArmModel*) { return motion; }, &played);
}

// Turns the run into OUT/rig by the program that does so, where it is installed.
absl::Status MakeRig(const CommandLine& line) {
  const absl::StatusOr<std::string> program = FindProgram("record-to-rig");
  if (!program.ok()) {
    std::printf("next: robostress record-to-rig %s --out %s/rig\n", line.client.out.c_str(),
                line.client.out.c_str());
    return absl::OkStatus();
  }
  std::fflush(stdout);
  const std::string payload = absl::StrCat(line.payload_kg), rig = line.client.out + "/rig";
  const char* arguments[] = {program->c_str(), line.client.out.c_str(), "--out", rig.c_str(),
                             "--payload-kg",   payload.c_str(),         nullptr};
  pid_t child = 0;
  int status = 0;
  if (posix_spawn(&child, program->c_str(), nullptr, nullptr, const_cast<char**>(arguments),
                  environ) != 0 ||
      waitpid(child, &status, 0) != child || status != 0) {
    return absl::InternalError(
        absl::StrCat(*program, " did not make a rig of ", line.client.out, "; run it by hand"));
  }
  std::printf("next: robostress calibrate --rig %s/rig.yaml --out FOUND --map own\n", rig.c_str());
  return absl::OkStatus();
}

absl::Status PlayForCalibration(const CommandLine& line, const ClientConfig& config,
                                const ClientRun::MotionMaker& motion) {
  bool played = false;
  RS_RETURN_IF_ERROR(PlayInRun(line, config, motion, &played));
  // An arm that is not there has no samples.
  if (!played || config.bus == "rehearse") return absl::OkStatus();
  if (!IsBridge(config)) return MakeRig(line);
  std::printf(
      "next: robostress record-to-rig %s --rig RIG --out %s/rig, RIG being what the motion "
      "was designed with\n",
      line.client.out.c_str(), line.client.out.c_str());
  return absl::OkStatus();
}

absl::Status Excite(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const ClientConfig config, ResolveConfig(line.client, WithoutPolicy));
  if (IsBridge(config) && line.source.empty())
    return absl::UnimplementedError(
        absl::StrCat("bus is ", config.bus,
                     ": excite swings a Piper's joints about its pose; for this arm let "
                     "`robostress excite --rig "
                     "RIG --out motion.csv` design a motion, and give --motion motion.csv"));
  if (!line.source.empty()) {
    RS_ASSIGN_OR_RETURN(const ArmAxes axes, AxesOf(config));
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, RigNamesOf(config));
    RS_ASSIGN_OR_RETURN(const Motion motion, ReadMotion(line.source, std::nullopt, axes, names));
    return PlayForCalibration(line, config,
                              [&](const ArmLimits&, const ArmModel*) { return motion; });
  }
  ExcitationOptions options = line.excitation;
  options.centre = kCentre;
  if (!config.home.empty()) std::copy_n(config.home.begin(), piper::kAxes, options.centre.begin());
  const LimiterOptions& most = config.control.limits;
  options.joint_velocity = std::min(options.joint_velocity, 0.95 * most.joint_velocity);
  options.joint_acceleration = std::min(options.joint_acceleration, 0.8 * most.joint_acceleration);
  return PlayForCalibration(line, config, [&](const ArmLimits& limits, const ArmModel* model) {
    return DesignExcitation(options, limits, config.control.workspace.guard ? model : nullptr);
  });
}

int Parse(cli::App& app, int argc, char** argv, CommandLine& line,
          absl::Status (*run)(const CommandLine&)) {
  return RunMain(
      app, argc, argv, [&] { return run(line); }, ClientExitCode);
}

}  // namespace

int ReplayMain(int argc, char** argv) {
  cli::App app("Plays a recorded motion within the limits of every run.", "robot_client replay");
  app.footer(kReplayExamples);
  CommandLine line;
  app.add_option("SOURCE", line.source, "a run's folder, a data set's folder, or a CSV")
      ->required();
  app.add_option("--episode", line.episode, "which episode; may be left out where there is one")
      ->check(cli::NonNegativeNumber());
  AddClientFlags(app, line.client);
  return Parse(app, argc, argv, line, Replay);
}

int ExciteMain(int argc, char** argv) {
  cli::App app("Moves an arm so that `robostress calibrate` can find its joints' errors.",
               "robot_client excite");
  app.footer(kExciteExamples);
  CommandLine line;
  app.add_option("--motion", line.source, "the motion (CSV); without it one is designed");
  app.add_option("--swing", line.excitation.most_swing, "most way of a joint to each side [rad]")
      ->check(cli::Range(0.05, 1.5))
      ->capture_default_str();
  app.add_option("--velocity", line.excitation.joint_velocity, "of the fastest part [rad/s]")
      ->check(cli::Range(0.05, 3.0))
      ->capture_default_str();
  app.add_option("--payload-kg", line.payload_kg, "in the gripper, for the rig")
      ->check(cli::Range(0.0, 5.0))
      ->capture_default_str();
  app.add_option("--seed", line.excitation.seed, "of the part in which all joints move")
      ->capture_default_str();
  AddClientFlags(app, line.client);
  return Parse(app, argc, argv, line, Excite);
}

}  // namespace robostress
