#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/models/hull.h"
#include "common/models/urdf_model.h"
#include "common/models/xml_file.h"

namespace robostress {

// What the links of a URDF are where they are touched, or else where they are seen.
struct UrdfShapes {
  struct Link {
    std::vector<Hull> parts;  // in the link's frame
    bool shown = false;       // it has a <collision> or a <visual>
  };
  std::vector<Link> links;           // as the model's
  int meshes = 0;                    // that were read
  std::vector<std::string> missing;  // as the file names them, with the reason
};

// Shapes of <collision>, or where a link has none its <visual>: boxes, spheres, cylinders in a
// prism about them, meshes in convex parts (mesh_parts.h). A mesh that is not found is listed.
// INVALID_ARGUMENT names file, line, value and remedy: sizes below 0 or that no arm has, a damaged
// mesh. What no joint moves may be larger: the ground.
absl::StatusOr<UrdfShapes> ReadUrdfShapes(const XmlFile& file, const UrdfModel& model,
                                          const std::vector<std::string>& packages);

// A pose of the file as a transform.
Eigen::Isometry3d PoseOf(const std::vector<double>& xyz, const std::vector<double>& rpy);

}  // namespace robostress
