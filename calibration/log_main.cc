// robostress-log: what a recording of an arm holds, and its first rig.

#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "calibration/data/recording_rig.h"
#include "calibration/data/recording_text.h"
#include "calibration/model/plant.h"
#include "common/recordings/recording.h"
#include "common/run_main.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress log inspect recording.mcap\n"
    "  robostress log inspect rosbag2_folder --model arm.urdf --out rigs/tuesday\n"
    "  robostress log inspect more.mcap --rig rigs/tuesday/rig.yaml --out rigs/wednesday\n"
    "  robostress calibrate --rig rigs/wednesday/rig.yaml --out runs/found\n\n"
    "Exit code: 0 done, also where no rig can be made (the last line says why); 1 writing failed; "
    "2 bad input.\n";

struct CommandLine {
  std::string recording, out, rig, model, command_times;
  std::vector<std::string> unit;
  RecordingOptions options;
};

// "deg", "0.0192", "shoulder=deg,elbow=0.0192".
absl::Status TakeUnit(CommandLine* line) {
  for (const std::string& word : line->unit) {
    const std::pair<std::string, std::string> named = absl::StrSplit(word, absl::MaxSplits('=', 1));
    const bool of_joint = absl::StrContains(word, '=');
    const std::string& unit = of_joint ? named.second : word;
    double to_rad = unit == "rad" ? 1 : unit == "deg" ? M_PI / 180 : 0;
    if (to_rad == 0 && (!absl::SimpleAtod(unit, &to_rad) || !std::isfinite(to_rad) || to_rad <= 0))
      return absl::InvalidArgumentError(
          absl::StrCat("--unit: is '", word, "', must be rad, deg or a factor above 0 to radians, ",
                       "of one joint JOINT=deg"));
    if (of_joint ? !line->options.to_rad_of.emplace(named.first, to_rad).second
                 : line->options.to_rad > 0)
      return absl::InvalidArgumentError(absl::StrCat("--unit: '", word, "' says a unit again"));
    if (!of_joint) line->options.to_rad = to_rad;
  }
  return absl::OkStatus();
}

// Prints what the model says of the recording's joints, and what was assumed.
absl::Status DescribeModel(const RecordingPlan& plan) {
  Rig rig;
  rig.file = "--model";
  rig.model = plan.model;
  for (const PlannedJoint& planned : plan.joints) {
    RigJoint joint;
    joint.name = planned.name;
    joint.input = planned.input;
    joint.fit = {"armature", "damping", "frictionloss"};  // as the first rig has it
    rig.joints.push_back(std::move(joint));
  }
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Plant> plant, Plant::Load(rig));
  std::printf("%s\n%s", plan.model.c_str(), ModelTableText(plant->facts(), "  ").c_str());
  return absl::OkStatus();
}

absl::Status Inspect(CommandLine line) {
  RS_RETURN_IF_ERROR(TakeUnit(&line));
  using Times = RecordingOptions::CommandTimes;
  if (line.command_times == "stamps") {
    line.options.command_times = Times::kStamps;
  } else if (line.command_times == "recorder") {
    line.options.command_times = Times::kRecorder;
  } else if (!line.command_times.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("--command-times: is '", line.command_times, "', must be stamps or recorder"));
  }
  if (!line.model.empty() && !line.rig.empty())
    return absl::InvalidArgumentError("--model: --rig names a model already; say one of them");
  std::optional<Rig> declared;
  if (!line.rig.empty()) {
    RS_ASSIGN_OR_RETURN(declared, ReadRig(line.rig));
    for (const RigJoint& joint : declared->joints) line.options.inputs[joint.name] = joint.input;
  }
  RS_ASSIGN_OR_RETURN(const std::string kind, KindOfRecording(line.recording));
  RecordingStatistics statistics;
  RS_RETURN_IF_ERROR(ReadRecording(line.recording, {line.options.rate_hz}, &statistics));
  RS_ASSIGN_OR_RETURN(RecordingPlan plan, PlanRecording(statistics, line.options));
  std::printf("%s: %s\n%s", line.recording.c_str(), kind.c_str(),
              DescribeRecording(statistics, plan).c_str());
  if (plan.joints.empty()) {
    std::printf("No rig: %s.\n", plan.why_none.c_str());
    return absl::OkStatus();
  }
  plan.model = line.model;
  if (!plan.model.empty()) RS_RETURN_IF_ERROR(DescribeModel(plan));
  if (line.out.empty()) {
    std::printf("--out DIR writes a rig of %d joints.\n", static_cast<int>(plan.joints.size()));
    return absl::OkStatus();
  }
  RS_ASSIGN_OR_RETURN(const RecordingRigSummary summary,
                      WriteRecordingRig(line.recording, plan, declared, line.out));
  std::printf("%s: %d logs, %.1f s (%.1f s too short or without motion of a joint left out)\n",
              summary.rig_file.c_str(), summary.logs, summary.seconds, summary.seconds_left_out);
  for (const auto& [rows, why] :
       {std::pair(summary.late_rows, "out of order"),
        std::pair(summary.bad_rows, "without a number or stamp"),
        std::pair(summary.wrong_stamps,
                  "with a stamp that fits neither the rows before nor behind it"),
        std::pair(summary.rows_without_command,
                  "before the first command, or the first after a clock was set back")})
    if (rows > 0) std::printf("left out: %lld rows %s\n", static_cast<long long>(rows), why);
  for (const std::string& key : summary.to_fill_in) std::printf("  fill in: %s\n", key.c_str());
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CommandLine line;
  cli::App app("Says what a recording of an arm holds and writes its first rig", "robostress log");
  app.footer(kExamples);
  app.require_subcommand(1);
  cli::App* inspect =
      app.add_subcommand("inspect", "Channels, rates, gaps, units, motions, and a first rig");
  inspect->add_option("RECORDING", line.recording, "a file or folder of a recorder")->required();
  inspect->add_option("--out", line.out, "directory to write rig.yaml and CSV logs into");
  inspect->add_option("--rig", line.rig,
                      "a rig of the same arm: its model, servos and effects are taken over");
  inspect->add_option("--model", line.model,
                      "the arm's model (URDF or MJCF), where there is no --rig yet: it is checked, "
                      "and goes into the first rig");
  inspect
      ->add_option("--joints", line.options.joints,
                   "joints of the rig, with commas between them (default: those that move)")
      ->delimiter(',');
  inspect->add_option("--topic", line.options.topic,
                      "channel of the positions, where several hold the same joints");
  inspect->add_option(
      "--commands", line.options.commands,
      "channel of the commands, where another was taken or it is far from the joints");
  inspect->add_option("--command-times", line.command_times,
                      "stamps or recorder: where commands stand whose stamps seem to be of another "
                      "clock (default: chosen, and said)");
  inspect
      ->add_option("--unit", line.unit,
                   "of angles where the recording does not say it or is wrong: rad, deg, or a "
                   "factor to radians; of one joint shoulder=deg, with commas between them")
      ->delimiter(',');
  inspect
      ->add_option("--rate-hz", line.options.rate_hz,
                   "rows per second, where the recording has no times")
      ->check(cli::Range(0.0, 1e5));
  return RunMain(
      app, argc, argv, [&] { return Inspect(line); },
      [](const absl::Status& status) {
        return absl::IsUnavailable(status) ? kFailed : kWrongCommand;
      });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
