#pragma once

#include <torch/types.h>

#include "common/types.h"
#include "server/policies/openpi/transforms.h"

namespace robostress::openpi {

// RGB bytes -> [1, 3, size, size] float32 in [-1, 1]. `image` is whole: width * height * 3 bytes.
torch::Tensor ImageTensor(const Image& image, int64_t size, ResizeFilter filter);

}  // namespace robostress::openpi
