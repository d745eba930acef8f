#pragma once

#include <mujoco/mujoco.h>

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/models/model_table.h"

namespace robostress::calibration {

// A compiled model as URDF, for what reads no MJCF.
struct UrdfOutput {
  std::string xml;
  std::map<std::string, std::string> meshes;  // binary STL [m] by its path in `xml`
  std::vector<std::string> joints;            // that move, in the model's order
  std::vector<std::string> sites, bodies;     // links that were one
  std::vector<ModelFact> facts;               // what URDF cannot say
};

// The root is link "world", whose frame is the model's. A joint's link has its frame at the joint;
// joints read as in the model, `ref` included. A body with several joints becomes as many links.
// Sites are links without mass. A link's shapes are those that touch, or where it has none all:
// an ellipsoid is the capsule about it, planes and height fields are left out. What stands on a
// free joint or is moved by hand (mocap) is left out, a ball joint is held. Linear couplings of two
// joints become <mimic>. Meshes are named MESHES/NAME.stl.
// INVALID_ARGUMENT: no joint turns or slides; numbers that are none or above 1e6.
absl::StatusOr<UrdfOutput> UrdfOf(const mjModel& model, const std::string& meshes);

}  // namespace robostress::calibration
