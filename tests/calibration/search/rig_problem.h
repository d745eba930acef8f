#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/model/plant.h"
#include "calibration/search/joint_fit.h"

namespace robostress::calibration {

// A rig with its logs, ready to be fitted one joint at a time.
struct LoadedRig {
  Rig rig;
  std::unique_ptr<Plant> plant;
  std::vector<MeasuredLog> logs;  // in the order of the rig

  JointProblem Problem(int joint) const;
  // The declared model with its `fit` lists free.
  absl::StatusOr<Hypothesis> Declared(int joint) const;
  SignalScales Scales(int joint) const;
};

absl::StatusOr<LoadedRig> LoadRig(const std::string& file);

}  // namespace robostress::calibration
