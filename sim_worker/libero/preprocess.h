#pragma once

#include "sim_worker/renderer.h"

namespace robostress::libero {

// How the originals draw: as MuJoCo does when nobody chooses. Sizes in pixels.
RenderOptions RenderAsLibero(int width, int height);

}  // namespace robostress::libero
