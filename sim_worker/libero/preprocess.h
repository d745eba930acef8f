#pragma once

#include "common/types.h"

namespace robostress::libero {

// Pillow's Image.resize(BILINEAR) on 8-bit RGB, bit for bit: a triangle filter that widens when it
// shrinks (antialiased), horizontally and then vertically, each pass in 22-bit fixed point.
Image ResizeBilinear(const Image& image, int width, int height);

// openpi's resize_with_pad: the aspect ratio is kept, the rest is black, the picture is centred.
Image ResizeWithPad(const Image& image, int width, int height);

// What a policy trained on LIBERO sees of an upright rendering. The originals hand out OpenGL's
// bottom-up pixels and openpi's client rotates them by 180 degrees; that is the upright picture
// with left and right exchanged.
Image MirrorAsLibero(const Image& upright);

}  // namespace robostress::libero
