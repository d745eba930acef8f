#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// The file that a URDF's <mesh filename> means: a path, "file://PATH", or "package://NAME/REST",
// which is NAME/REST in a folder above the URDF or in one of `packages`, or REST in one called
// NAME. Empty: there is none.
std::string FindMesh(const std::string& filename, const std::string& urdf,
                     const std::vector<std::string>& packages);

// Whether ReadMesh knows the ending: .stl, .obj, .dae.
bool IsMeshRead(const std::string& path);

// Corners of a mesh's triangles, three a triangle, in the file's frame [m]. Of COLLADA its unit
// counts, and its up axis does not, as in RViz and MoveIt.
// INVALID_ARGUMENT names the file and the remedy: no triangles, more than 2,000,000, no numbers.
absl::StatusOr<std::vector<Eigen::Vector3d>> ReadMesh(const std::string& path);
// Of a file's content; the path says of which kind it is.
absl::StatusOr<std::vector<Eigen::Vector3d>> ParseMesh(const std::string& path,
                                                       const std::string& text);

}  // namespace robostress
