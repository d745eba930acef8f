#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// Corners of the triangles that a COLLADA file's scene shows, three a triangle, placed by its
// nodes, in metres by its unit: <triangles>, <polylist> and <polygons>. Its up axis turns nothing.
// INVALID_ARGUMENT: no XML, an index or a number that is none, more than `most` triangles.
absl::StatusOr<std::vector<Eigen::Vector3d>> ReadCollada(const std::string& name,
                                                         const std::string& text, size_t most);

}  // namespace robostress
