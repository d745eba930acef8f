#include "sim_worker/libero/preprocess.h"

namespace robostress::libero {

RenderOptions RenderAsLibero(int width, int height) {
  return {.width = width,
          .height = height,
          .shadows = true,
          .reflections = true,
          .samples = 4,
          .shadow_size = 4096};
}

}  // namespace robostress::libero
