#pragma once

#include <mujoco/mujoco.h>

namespace robostress::libero {

// Draws with fewer triangles: in every mesh of more than a thousand the vertices of one cell of a
// grid move to their mean (vertex clustering; Rossignac and Borrel 1993), those of them that face
// the same octant and lie in the same eighth of the texture become one, and faces without an area
// are dropped; surfaces stay closed. Only what a renderer reads changes: mesh_vert, mesh_normal,
// mesh_texcoord, mesh_face, mesh_facenum, so nothing may be simulated with the model. cell: of the
// grid [m].
void ThinMeshes(mjModel& model, double cell);

}  // namespace robostress::libero
