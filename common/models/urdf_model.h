#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/models/model_table.h"
#include "common/models/urdf_parts.h"
#include "common/models/xml_file.h"

namespace robostress {

// A robot's description, read and checked.
struct UrdfModel {
  // URDF with inertials, joints and nothing else, which MuJoCo's own reader compiles without any
  // other file. Joints that do not move are fixed at 0.
  std::string xml;
  std::map<std::string, double> effort;  // limits of joints that move, where above 0 [Nm]
  std::string payload_link;              // a link called payload, tip, tool, tool0 ...; or empty
  std::vector<ModelFact> facts;          // of the whole and of links
  // The same in parts, inertias repaired; elements are of the file that was read.
  std::vector<urdf::Link> links;
  std::vector<urdf::Joint> joints;
  std::vector<int> order;  // of links, parents first
};

// Reads a robot description whose root is <robot>. `moving`: the joints that move, at least one;
// all others are held at 0 and listed. Visual and collision geometry is left out, so no mesh is
// needed. An inertia whose principal moments break A + B >= C becomes the nearest that keeps it
// (least squares: each of the smaller ones grows and the largest shrinks by a third of what is
// missing). A link without mass that moves and carries links with mass gets 1e-9 kg.
// Errors name file, line, element, value and remedy; xacro is refused with the command that
// expands it. At most 1000 links.
absl::StatusOr<UrdfModel> ReadUrdf(const XmlFile& file, const std::vector<std::string>& moving);

}  // namespace robostress
