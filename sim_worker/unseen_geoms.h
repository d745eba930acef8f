#pragma once

#include <mujoco/mujoco.h>

namespace robostress {

// Takes out of an abstract scene the geoms that no pixel of its camera can show, so that a software
// rasteriser does not transform their triangles: the picture stays the same to the bit. MuJoCo
// itself draws every geom. A geom stays if its bounding sphere meets the view's frustum, or if the
// sphere's image in a mirror that is seen does; all stay while a light of the scene casts shadows.
// aspect: width over height of the picture.
void LeaveOutUnseen(const mjModel& model, double aspect, mjvScene& scene);

}  // namespace robostress
