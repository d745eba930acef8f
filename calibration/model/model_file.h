#pragma once

#include <mujoco/mujoco.h>

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "common/models/model_table.h"
#include "common/models/xml_file.h"

namespace robostress::calibration {

struct ModelDeleter {
  void operator()(mjModel* model) const { mj_deleteModel(model); }
};

using CompiledModel = std::unique_ptr<mjModel, ModelDeleter>;
// Compiles text that needs no other file; errors name `file`.
absl::StatusOr<CompiledModel> CompileModel(const std::string& file, const std::string& xml);
// The same model as MJCF, numbers to six digits.
absl::StatusOr<std::string> MjcfOf(const std::string& file, const std::string& xml);

// Sites that are a payload's place, the first that there is.
inline constexpr const char* kPayloadSites[] = {
    "payload", "tip", "tool", "end_effector", "gripper0_grip_site", "attachment_site"};

struct LoadedModel {
  CompiledModel model;
  std::map<std::string, double> effort;  // limits of the rig's joints that the file says [Nm]
  bool urdf = false;
  std::string payload_link;  // of a URDF; empty: none is named so
  std::vector<ModelFact> facts;
};

// As MuJoCo reads it; where it cannot, what ReduceMjcf leaves, with shapes if their files are
// there.
absl::StatusOr<LoadedModel> LoadMjcf(const XmlFile& file);

// The model of a rig: MJCF (root <mujoco>) or URDF (root <robot>), whatever the file is called.
// Of a URDF the joints that the rig does not list are held at 0. Errors name the file, and line,
// element and remedy where they can.
absl::StatusOr<LoadedModel> LoadModel(const Rig& rig);

}  // namespace robostress::calibration
