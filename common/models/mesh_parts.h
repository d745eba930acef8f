#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "common/models/hull.h"

namespace robostress {

// Convex parts, at most `most`, that hold every triangle of a mesh, whose corners are three a
// triangle: a bent link in one hull would touch what stands in its bend. They reach 1.5 mm further
// than the mesh, more where 96 corners a part do not follow it. What is inside a closed surface may
// be in none. Empty without triangles.
std::vector<Hull> PartsOf(const std::vector<Eigen::Vector3d>& corners, size_t most);

}  // namespace robostress
