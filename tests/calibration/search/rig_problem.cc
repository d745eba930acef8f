#include "tests/calibration/search/rig_problem.h"

#include <cmath>

#include "common/status_macros.h"

namespace robostress::calibration {

absl::StatusOr<LoadedRig> LoadRig(const std::string& file) {
  LoadedRig loaded;
  RS_ASSIGN_OR_RETURN(loaded.rig, ReadRig(file));
  RS_ASSIGN_OR_RETURN(loaded.plant, Plant::Load(loaded.rig));
  for (const RigLog& log : loaded.rig.logs) {
    RS_ASSIGN_OR_RETURN(MeasuredLog measured, ReadMeasuredLog(loaded.rig, log));
    loaded.logs.push_back(std::move(measured));
  }
  return loaded;
}

JointProblem LoadedRig::Problem(int joint) const {
  const int window = static_cast<int>(std::lround(rig.metric.window_s * rig.rate_hz));
  return JointProblem(rig.joints[joint].name, MakeTracks(*plant, logs, joint), window);
}

SignalScales LoadedRig::Scales(int joint) const {
  return MeasureScales(rig.joints[joint], MakeTracks(*plant, logs, joint));
}

absl::StatusOr<Hypothesis> LoadedRig::Declared(int joint) const {
  RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig, *plant, joint));
  return DeclaredHypothesis(rig.joints[joint], model, Scales(joint),
                            MeanInertia(MakeTracks(*plant, logs, joint)));
}

}  // namespace robostress::calibration
