#include "calibration/search/command_shape.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "calibration/search/joint_case.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int kIterations = 8;
constexpr double kClearlyBetter = 0.9;  // of the error with lines

bool MayStep(const std::vector<MeasuredLog>& logs, int joint) {
  return std::any_of(logs.begin(), logs.end(),
                     [&](const MeasuredLog& log) { return log.joints[joint].step_rows > 0; });
}

// Projected, of the fit logs.
absl::StatusOr<double> ErrorOf(const Rig& rig, const Plant& plant,
                               const std::vector<MeasuredLog>& logs, int index) {
  JointCase joint(rig, plant, logs, index);
  const std::vector<JointTrack>& tracks = joint.problem.tracks();
  RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig, plant, index));
  const SignalScales scales = MeasureScales(joint.declared(), tracks);
  RS_ASSIGN_OR_RETURN(Hypothesis start,
                      DeclaredHypothesis(joint.declared(), model, scales, MeanInertia(tracks)));
  int step = 1;
  for (const MeasuredLog& log : logs) step = std::max(step, log.joints[index].step_rows);
  for (FreeParameter& free : start.free) {
    if (free.path == "command_shift") free.lower = -step, free.upper = step;
  }
  joint.problem.LinearizeStarts(model);
  return Minimise(joint.problem, start, joint.Fit(), kIterations, 1e-3).rms;
}

}  // namespace

absl::Status ChooseCommandShapes(const Rig& rig, const Plant& plant,
                                 std::vector<MeasuredLog>& logs) {
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i) {
    if (rig.joints[i].input != JointInput::kPositionTarget || !MayStep(logs, i)) continue;
    std::vector<MeasuredLog> stepped = logs;
    for (MeasuredLog& log : stepped) {
      JointRecord& record = log.joints[i];
      if (record.step_rows == 0) continue;
      record.command = record.stepped_command;
      log.notes.push_back(absl::StrCat(rig.joints[i].name, ": the command steps every ",
                                       record.step_rows,
                                       " rows, and the recorder drew lines between: the steps are "
                                       "put back"));
    }
    RS_ASSIGN_OR_RETURN(const double with_lines, ErrorOf(rig, plant, logs, i));
    RS_ASSIGN_OR_RETURN(const double with_steps, ErrorOf(rig, plant, stepped, i));
    if (with_steps < kClearlyBetter * with_lines) {
      logs = std::move(stepped);
    } else {
      for (MeasuredLog& log : logs) log.joints[i].step_rows = 0;
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress::calibration
