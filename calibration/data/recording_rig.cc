#include "calibration/data/recording_rig.h"

#include <algorithm>
#include <filesystem>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/data/piece_writer.h"
#include "calibration/data/row_merger.h"
#include "common/atomic_file.h"
#include "common/recordings/recording.h"
#include "common/status_macros.h"
#include "yaml-cpp/yaml.h"

namespace robostress::calibration {
namespace {

constexpr char kFillIn[] = "FILL_IN";
constexpr int kHeldOutEvery = 3;

const char* RoleOfPiece(size_t index) {
  return index % kHeldOutEvery == kHeldOutEvery - 1 ? "held_out" : "fit";
}

std::string YamlScalar(const std::string& text) {
  YAML::Emitter out;
  out << text;
  return out.c_str();
}

// A rig without what the recording does not say.
std::string FirstRig(const std::string& recording, const RecordingPlan& plan,
                     const std::string& out, const std::vector<std::string>& logs,
                     std::vector<std::string>* to_fill_in) {
  const std::string model =
      plan.model.empty()
          ? absl::StrCat(kFillIn, "  # MJCF or URDF file in which the joints have the names below")
          : YamlScalar(RelativePath(plan.model, out));
  std::string text =
      absl::StrCat("# From ", std::filesystem::path(recording).filename().string(),
                   ", by `robostress log inspect`. Replace every ", kFillIn,
                   ": the recording does not say it.\nname: recorded\nmodel: ", model, "\n",
                   absl::StrFormat("rate_hz: %.6g\njoints:\n", plan.rate_hz));
  if (plan.model.empty()) to_fill_in->push_back("model");
  for (const PlannedJoint& joint : plan.joints) {
    const bool servo = joint.input == JointInput::kPositionTarget;
    absl::StrAppend(
        &text, "  - name: ", YamlScalar(joint.name), "\n    input: ",
        servo ? "position_target" : "torque  # tau is the recording's effort: is it Nm?", "\n");
    if (servo) {
      absl::StrAppend(&text, "    servo: {kp: ", kFillIn, ", kd: ", kFillIn,
                      "}  # [Nm/rad], [Nm s/rad]\n");
      to_fill_in->push_back(absl::StrCat(joint.name, ".servo.kp"));
      to_fill_in->push_back(absl::StrCat(joint.name, ".servo.kd"));
    }
    absl::StrAppend(&text, "    fit: [armature, damping, frictionloss]\n");
  }
  text += "logs:\n";
  for (size_t i = 0; i < logs.size(); ++i)
    absl::StrAppend(&text, "  - {file: ", logs[i], ", role: ", RoleOfPiece(i), "}\n");
  return text + "metric: {window_s: 0.5, unit: rad}\n";
}

absl::StatusOr<std::string> FilledRig(Rig rig, const RecordingPlan& plan, const std::string& out,
                                      const std::vector<std::string>& logs) {
  rig.file = (std::filesystem::path(out) / "rig.yaml").string();
  rig.rate_hz = plan.rate_hz;
  std::vector<RigJoint> joints;
  for (const PlannedJoint& planned : plan.joints) {
    const auto found =
        std::find_if(rig.joints.begin(), rig.joints.end(),
                     [&](const RigJoint& joint) { return joint.name == planned.name; });
    if (found == rig.joints.end()) {
      std::vector<std::string> known;
      for (const RigJoint& joint : rig.joints) known.push_back(joint.name);
      return absl::InvalidArgumentError(absl::StrCat("--rig: has no joint '", planned.name,
                                                     "', it has ", absl::StrJoin(known, ", "),
                                                     "; say --joints with those of both"));
    }
    joints.push_back(*found);
    joints.back().input = planned.input;
    joints.back().enable.clear();
  }
  rig.joints = std::move(joints);
  rig.logs.clear();
  for (size_t i = 0; i < logs.size(); ++i) {
    RigLog log;
    log.file = (std::filesystem::path(out) / logs[i]).string();
    log.role = i % kHeldOutEvery == kHeldOutEvery - 1 ? LogRole::kHeldOut : LogRole::kFit;
    rig.logs.push_back(std::move(log));
  }
  return WriteRig(rig);
}

}  // namespace

absl::StatusOr<RecordingRigSummary> WriteRecordingRig(const std::string& recording,
                                                      const RecordingPlan& plan,
                                                      const std::optional<Rig>& declared,
                                                      const std::string& out) {
  // Before the recording is read once more.
  if (declared) RS_RETURN_IF_ERROR(FilledRig(*declared, plan, out, {}).status());
  RS_RETURN_IF_ERROR(MakeDirectories(out));
  std::error_code error;
  if (!std::filesystem::is_empty(out, error))
    return absl::InvalidArgumentError(absl::StrCat(
        "--out ", out, ": holds files already, perhaps a rig that you filled in; name a new one"));
  PieceWriter writer(plan, out);
  RowMerger merger(plan, &writer);
  RS_RETURN_IF_ERROR(ReadRecording(recording, {plan.made_up_rate_hz}, &merger));
  RS_RETURN_IF_ERROR(merger.Finish());
  RecordingRigSummary summary;
  summary.logs = static_cast<int>(writer.files().size());
  summary.seconds = writer.seconds();
  summary.seconds_left_out = writer.seconds_left_out();
  summary.late_rows = writer.late_rows();
  summary.bad_rows = merger.bad_rows();
  summary.rows_without_command = merger.rows_without_command();
  summary.wrong_stamps = merger.wrong_stamps();
  if (summary.logs == 0)
    return absl::FailedPreconditionError(absl::StrFormat(
        "%s: no piece of 50 rows is left in which every joint moves: %.1f s in pieces without, %d "
        "rows before the first command or after a clock was set, %d with a number missing, %d with "
        "a "
        "stamp that does not fit; say --joints with those that move together",
        recording, summary.seconds_left_out, summary.rows_without_command, summary.bad_rows,
        summary.wrong_stamps));
  std::string text = FirstRig(recording, plan, out, writer.files(), &summary.to_fill_in);
  if (declared) {
    summary.to_fill_in.clear();
    RS_ASSIGN_OR_RETURN(text, FilledRig(*declared, plan, out, writer.files()));
  }
  summary.rig_file = (std::filesystem::path(out) / "rig.yaml").string();
  RS_RETURN_IF_ERROR(WriteFileAtomically(summary.rig_file, text));
  if (declared) RS_RETURN_IF_ERROR(ReadRig(summary.rig_file).status());
  return summary;
}

}  // namespace robostress::calibration
