// robostress-record-to-rig: turns recorded runs of an arm into a rig with logs.

#include <cstdio>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "calibration/data/client_recordings.h"
#include "calibration/data/recorded_rig.h"
#include "calibration/data/sim_recordings.h"
#include "common/command_line.h"
#include "common/robot_description.h"
#include "common/run_main.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kExamples[] = R"(
Examples
  robostress sweep --suites tabletop_goal --tasks 3 --policies expert --methods base --scenarios worn.yaml \
      --record-joints --out runs/worn
  robostress record-to-rig runs/worn --out rigs/worn
  robostress calibrate --rig rigs/worn/rig.yaml --out found
  robostress record-to-rig runs/piper_tuesday --out rigs/tuesday     # what robot_client left
  robostress record-to-rig runs/so101 --rig so101/rig.yaml --out rigs/so101    # of another arm

DIR gets rig.yaml, the arm's MJCF (gripper as a fixed mass, no scene) and a CSV per piece of free motion: rows
near contacts are left out, because the rig's model has no objects. With --rig model and joints are that rig's. Roles go by episode: the last of several tasks
is the transfer regime; of every other task each third episode is held out; the rest is fitted. A Piper's or
another arm's recording tells no contacts: move it freely. A Piper's joints are driven by the torques that its
motor currents amount to.

Exit code: 0 done; 1 writing failed; 2 bad input.
)";

struct CommandLine {
  std::string run, out, unit, name, rig_file;
  std::vector<std::string> joints;
  double rate_hz = 250, payload_kg = 0;
  RecordedRigOptions rig;
};

absl::StatusOr<RecordedRigSummary> ConvertClientRun(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(std::vector<RecordedEpisode> episodes,
                      EpisodesOfClientRun(line.run, line.rig.held_out_every));
  RecordedRigOptions options = line.rig;
  options.encoder_noise = 0;  // the arm's own is in it
  if (!line.rig_file.empty()) {
    RS_ASSIGN_OR_RETURN(const Rig rig, ReadRig(line.rig_file, RigLogs::kNone));
    std::vector<std::string> names = line.joints;
    if (names.empty()) {
      RS_ASSIGN_OR_RETURN(const auto of_run, JointNamesOfClientRun(line.run));
      if (of_run) names = *of_run;
    }
    RS_ASSIGN_OR_RETURN(RecordedArm arm, ArmOfRig(rig, names, &episodes));
    if (!line.name.empty()) arm.name = line.name;
    return WriteRecordedRig(arm, episodes, options, line.out);
  }
  if (episodes.front().q.size() != kPiper.joints.size())
    return absl::InvalidArgumentError(absl::StrCat(
        line.run, ": is of an arm of ", episodes.front().q.size(),
        " joints, and the model of a rig made here is a Piper's; give --rig with this arm's model "
        "and servos, it needs no logs (docs/calibrate-my-arm.md)"));
  const std::string name = line.name.empty() ? "piper" : line.name;
  return WriteRecordedRig(PiperOfRecordings(name, line.payload_kg), episodes, options, line.out);
}

absl::StatusOr<RecordedRigSummary> Convert(const CommandLine& line) {
  if (!line.joints.empty() && line.rig_file.empty())
    return absl::InvalidArgumentError("--joints names the joints of --rig; give that too");
  if (IsClientRun(line.run)) return ConvertClientRun(line);
  if (!line.rig_file.empty())
    return absl::InvalidArgumentError(absl::StrCat(
        line.run, ": has no ticks.csv, and --rig is for a run of robot_client; give its folder"));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> files, FindJointLogs(line.run, line.unit));
  std::vector<RecordedEpisode> episodes;
  for (const std::string& file : files) {
    RS_ASSIGN_OR_RETURN(const JointLog log, ReadJointLog(file));
    RS_ASSIGN_OR_RETURN(RecordedEpisode episode, EpisodeOfJointLog(log, line.rate_hz));
    episodes.push_back(std::move(episode));
  }
  const std::string name = line.name.empty() ? "panda" : line.name;
  return WriteRecordedRig(PandaOfRecordings(name), episodes, line.rig, line.out);
}

int Main(int argc, char** argv) {
  cli::App app("Turns recorded runs of an arm into a rig with logs, for `robostress calibrate`.",
               "robostress record-to-rig");
  app.footer(kExamples);
  CommandLine line;
  bool no_transfer = false;
  app.add_option("RUN", line.run,
                 "a sweep's or a unit's directory, recorded with --record-joints, or a run's of "
                 "robot_client")
      ->required();
  app.add_option("--out", line.out, "directory to write")->required();
  app.add_option("--unit", line.unit, "id of the unit, where the sweep has several");
  app.add_option("--name", line.name, "of the rig; panda or piper if not given");
  app.add_option(
      "--rig", line.rig_file,
      "rig of the arm that robot_client moved, whose model, servos and effects are taken "
      "over; it needs no logs");
  app.add_option(
         "--joints", line.joints,
         "what that rig calls J1 and on, in order (default: as the run says; of a run before "
         "0.2 all of the rig's joints, as listed)")
      ->delimiter(',');
  app.add_option("--payload-kg", line.payload_kg, "in the Piper's gripper while it was recorded")
      ->check(cli::Range(0.0, 5.0))
      ->capture_default_str();
  app.add_option("--rate-hz", line.rate_hz, "rows per second: 500, 250, 125 or 100")
      ->capture_default_str();
  app.add_option("--contact-limit", line.rig.contact_limit_N,
                 "rows with larger contact forces are left out [N]")
      ->capture_default_str();
  app.add_option("--encoder-noise", line.rig.encoder_noise,
                 "noise to add to the angles, which a simulator reads exactly [rad]")
      ->check(cli::NonNegativeNumber())
      ->capture_default_str();
  app.add_option("--seed", line.rig.seed, "of that noise")->capture_default_str();
  app.add_option("--window", line.rig.window_s, "length of the free runs that are compared [s]")
      ->check(cli::PositiveNumber())
      ->capture_default_str();
  app.add_flag("--no-transfer", no_transfer, "no task is a transfer regime");
  return RunMain(
      app, argc, argv,
      [&]() -> absl::Status {
        line.rig.transfer = !no_transfer;
        RS_ASSIGN_OR_RETURN(const auto summary, Convert(line));
        std::printf(
            "%s: %d episodes, %d pieces of free motion, %.1f s (%.1f s near contacts or too short "
            "left "
            "out)\nlogs: %d fit, %d held_out, %d transfer\n",
            summary.rig_file.c_str(), summary.episodes, summary.pieces, summary.seconds,
            summary.seconds_left_out, summary.logs_of_role[0], summary.logs_of_role[1],
            summary.logs_of_role[2]);
        return absl::OkStatus();
      },
      [](const absl::Status& status) {
        return absl::IsUnavailable(status) ? kFailed : kWrongCommand;
      });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
