#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"

namespace robostress::calibration {

// A rig's URDF with its shapes, meshes found as common/models/mesh_file.h says and cut into convex
// parts, which MuJoCo's own reader does not do: it takes a package's meshes for files beside the
// URDF, and no COLLADA. Joints that the rig does not list are held at 0.
struct ShapedModel {
  std::shared_ptr<mjModel> model;
  std::vector<std::string> missing;  // meshes that are not there
};
// Errors name file, line, value and remedy. INVALID_ARGUMENT too where the file is no URDF.
absl::StatusOr<ShapedModel> LoadUrdfWithShapes(const Rig& rig);

}  // namespace robostress::calibration
