#pragma once

#include "common/types.h"

namespace robostress {

// Pillow's Image.resize(BILINEAR) on 8-bit RGB, bit for bit: a triangle filter that widens when it
// shrinks (antialiased), horizontally and then vertically, each pass in 22-bit fixed point. Sizes
// are positive.
Image ResizeBilinear(const Image& image, int width, int height);

// openpi's resize_with_pad, what its clients do before they send an image: the aspect ratio is
// kept, the rest is black, the picture is centred.
Image ResizeWithPad(const Image& image, int width, int height);

}  // namespace robostress
