#include "calibration/search/command_shape.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "calibration/data/log_faults.h"
#include "calibration/search/joint_case.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int kIterations = 8;
constexpr double kClearlyBetter = 0.9;  // of the error with lines
constexpr double kAsGood = 1.1;         // of the same

bool MayStep(const std::vector<MeasuredLog>& logs, int joint) {
  return std::any_of(logs.begin(), logs.end(),
                     [&](const MeasuredLog& log) { return log.joints[joint].step_rows > 0; });
}

// A recorder draws all logs alike, of which some may bend too rarely to tell.
void ShareSteps(std::vector<MeasuredLog>& logs, int joint) {
  int rows = 0;
  for (const MeasuredLog& log : logs) rows = std::max(rows, log.joints[joint].step_rows);
  for (MeasuredLog& log : logs) {
    JointRecord& record = log.joints[joint];
    if (record.step_rows > 0 || !BendsEvery(record.command, rows)) continue;
    record.step_rows = rows;
    record.stepped_command = StepsOfLines(record.command, rows);
  }
}

// Of the declared model with a shift of up to a step.
struct ShapeFit {
  double error = 0;             // projected, of the fit logs
  bool within_its_row = false;  // the shift is one that every fit leaves open
};

absl::StatusOr<ShapeFit> FitOf(const Rig& rig, const Plant& plant,
                               const std::vector<MeasuredLog>& logs, int index) {
  JointCase joint(rig, plant, logs, index);
  const std::vector<JointTrack>& tracks = joint.problem.tracks();
  RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig, plant, index));
  const SignalScales scales = MeasureScales(joint.declared(), tracks);
  RS_ASSIGN_OR_RETURN(Hypothesis start,
                      DeclaredHypothesis(joint.declared(), model, scales, MeanInertia(tracks)));
  int step = 1;
  for (const MeasuredLog& log : logs) step = std::max(step, log.joints[index].step_rows);
  Eigen::Index shift = 0;
  double low = 0, high = 0;
  for (size_t i = 0; i < start.free.size(); ++i) {
    FreeParameter& free = start.free[i];
    if (free.path != "command_shift") continue;
    shift = static_cast<Eigen::Index>(i), low = free.lower, high = free.upper;
    free.lower = -step, free.upper = step;
  }
  joint.problem.LinearizeStarts(model);
  const JointFit fit = Minimise(joint.problem, start, joint.Fit(), kIterations, 1e-3);
  return ShapeFit{fit.rms, fit.best.x[shift] > low && fit.best.x[shift] < high};
}

// Lines that a recorder drew lead the steps by half a step. Where the servo smooths what else they
// differ in, steps are likelier than a delay of just that.
bool AreSteps(const ShapeFit& lines, const ShapeFit& steps) {
  return steps.error < kClearlyBetter * lines.error ||
         (steps.error < kAsGood * lines.error && steps.within_its_row && !lines.within_its_row);
}

}  // namespace

absl::Status ChooseCommandShapes(const Rig& rig, const Plant& plant,
                                 std::vector<MeasuredLog>& logs) {
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i) {
    if (rig.joints[i].input != JointInput::kPositionTarget || !MayStep(logs, i)) continue;
    ShareSteps(logs, i);
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
    RS_ASSIGN_OR_RETURN(const ShapeFit with_lines, FitOf(rig, plant, logs, i));
    RS_ASSIGN_OR_RETURN(const ShapeFit with_steps, FitOf(rig, plant, stepped, i));
    if (AreSteps(with_lines, with_steps)) {
      logs = std::move(stepped);
    } else {
      for (MeasuredLog& log : logs) log.joints[i].step_rows = 0;
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress::calibration
