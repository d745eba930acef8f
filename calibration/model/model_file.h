#pragma once

#include <mujoco/mujoco.h>

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "common/models/model_table.h"

namespace robostress::calibration {

struct ModelDeleter {
  void operator()(mjModel* model) const { mj_deleteModel(model); }
};

// Sites that are a payload's place, the first that there is.
inline constexpr const char* kPayloadSites[] = {
    "payload", "tip", "tool", "end_effector", "gripper0_grip_site", "attachment_site"};

struct LoadedModel {
  std::unique_ptr<mjModel, ModelDeleter> model;
  std::map<std::string, double> effort;  // limits of the rig's joints that the file says [Nm]
  std::string payload_link;              // of a URDF; empty: none is named so
  std::vector<ModelFact> facts;
};

// The model of a rig: MJCF (root <mujoco>) or URDF (root <robot>), whatever the file is called.
// Of a URDF the joints that the rig does not list are held at 0. Errors name the file, and line,
// element and remedy where they can.
absl::StatusOr<LoadedModel> LoadModel(const Rig& rig);

}  // namespace robostress::calibration
