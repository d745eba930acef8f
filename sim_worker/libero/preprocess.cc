#include "sim_worker/libero/preprocess.h"

#include <algorithm>

namespace robostress::libero {

Image MirrorAsLibero(const Image& upright) {
  Image mirrored = upright;
  for (int y = 0; y < upright.height; ++y) {
    for (int x = 0; x < upright.width; ++x) {
      std::copy_n(upright.data.begin() + 3 * (size_t(y) * upright.width + upright.width - 1 - x), 3,
                  mirrored.data.begin() + 3 * (size_t(y) * upright.width + x));
    }
  }
  return mirrored;
}

}  // namespace robostress::libero
