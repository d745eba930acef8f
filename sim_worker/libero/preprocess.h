#pragma once

#include <Eigen/Core>

#include "common/types.h"
#include "sim_worker/renderer.h"

namespace robostress::libero {

// How the originals draw: as MuJoCo does when nobody chooses. Sizes in pixels.
RenderOptions RenderAsLibero(int width, int height);

// MuJoCo's quaternion w x y z as axis times angle [rad], the angle in [0, 2 pi]: robosuite's
// quat2axisangle, which openpi's client uses. Not the short way round where w < 0; zero where
// |w| = 1.
Eigen::Vector3d AxisAngleAsLibero(const double* wxyz);

}  // namespace robostress::libero
