#pragma once

#include <array>
#include <optional>
#include <string_view>

namespace robostress::libero {

// Bounding sphere of a visual mesh around its centre of mass, in the file's own units (before the
// asset's scale), as MuJoCo 2.2 computes them when it compiles the mesh (geom_pos and geom_rbound).
//
// Visual geoms collide with nothing, and still MuJoCo's broad phase asks for their bounds: a body's
// box in mj_broadphase spans all of its geoms, and the sweep's axis is the principal axis of all
// geom centres. A static body other than the world that holds a plane (the floor of libero_object
// and of the living room) is paired with every body once for its plane and once more while the
// boxes overlap; the contacts with the floor are then doubled. A replaced visual keeps these two
// figures, so that the pairs are those of a complete checkout.
struct VisualBounds {
  std::array<double, 3> centre;
  double radius;
};

// Of a file by the end of its path, e.g. ".../stable_hope_objects/milk/visual/textured_vis.msh".
// Known: the Panda with its gripper and the objects of libero_object whose files could be measured.
std::optional<VisualBounds> FindVisualBounds(std::string_view file);

}  // namespace robostress::libero
