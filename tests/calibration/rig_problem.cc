#include "tests/calibration/rig_problem.h"

#include <cmath>

#include "common/status_macros.h"

namespace robostress::calibration {

absl::StatusOr<LoadedRig> LoadRig(const std::string& file) {
  LoadedRig loaded;
  RS_ASSIGN_OR_RETURN(loaded.rig, ReadRig(file));
  RS_ASSIGN_OR_RETURN(loaded.plant, Plant::Load(loaded.rig));
  for (const RigLog& log : loaded.rig.logs) {
    RS_ASSIGN_OR_RETURN(MeasuredLog measured, ReadMeasuredLog(loaded.rig, log));
    loaded.logs.push_back(std::make_unique<MeasuredLog>(std::move(measured)));
  }
  return loaded;
}

WindowSet LoadedRig::Windows(const JointProblem& problem, LogRole role) const {
  WindowSet chosen;
  for (const Window& window : problem.windows()) chosen.push_back(logs[window.track]->role == role);
  return chosen;
}

std::vector<JointTrack> LoadedRig::JointTracks(int joint) const {
  std::vector<JointTrack> tracks;
  for (const auto& log : logs) {
    JointTrack track;
    track.log = log.get();
    track.joint = joint;
    track.single = plant->single();
    track.rows = plant->Rows(joint, *log);
    tracks.push_back(std::move(track));
  }
  return tracks;
}

JointProblem LoadedRig::Problem(int joint) const {
  const int window = static_cast<int>(std::lround(rig.metric.window_s * rig.rate_hz));
  return JointProblem(rig.joints[joint].name, JointTracks(joint), window);
}

SignalScales LoadedRig::Scales(int joint) const {
  return MeasureScales(rig.joints[joint], JointTracks(joint));
}

absl::StatusOr<Hypothesis> LoadedRig::Declared(int joint) const {
  RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig, *plant, joint));
  return DeclaredHypothesis(rig.joints[joint], model, Scales(joint),
                            JointTracks(joint).front().rows.front().inertia);
}

}  // namespace robostress::calibration
