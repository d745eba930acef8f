#pragma once

#include "common/types.h"

namespace robostress::libero {

// What a policy trained on LIBERO sees of an upright rendering. The originals hand out OpenGL's
// bottom-up pixels and openpi's client rotates them by 180 degrees; that is the upright picture
// with left and right exchanged.
Image MirrorAsLibero(const Image& upright);

}  // namespace robostress::libero
