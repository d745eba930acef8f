#include "server/policies/openpi/images.h"

#include <torch/types.h>

#include <algorithm>

#include "common/image_resize.h"

namespace robostress::openpi {
namespace {

torch::Tensor PixelTensor(const Image& image) {
  const torch::Tensor bytes = at::from_blob(const_cast<uint8_t*>(image.data.data()),
                                            {1, image.height, image.width, 3}, torch::kUInt8);
  // The order of openpi's operations, for its bits: x / 255 * 2 - 1.
  return bytes.to(torch::kFloat32).div_(255).mul_(2).sub_(1).permute({0, 3, 1, 2}).contiguous();
}

torch::Tensor Interpolate(const torch::Tensor& image, int64_t size) {
  const int64_t height = image.size(2), width = image.size(3);
  const double ratio = static_cast<double>(std::max(width, height)) / static_cast<double>(size);
  const auto inner = [&](int64_t side) {
    return std::clamp<int64_t>(static_cast<int64_t>(static_cast<double>(side) / ratio), 1, size);
  };
  const int64_t h = inner(height), w = inner(width);
  torch::Tensor padded = at::full({1, 3, size, size}, -1.0f);
  padded.narrow(2, (size - h) / 2, h)
      .narrow(3, (size - w) / 2, w)
      .copy_(at::upsample_bilinear2d(image, {h, w}, /*align_corners=*/false).clamp(-1, 1));
  return padded;
}

}  // namespace

torch::Tensor ImageTensor(const Image& image, int64_t size, ResizeFilter filter) {
  if (image.width == size && image.height == size) return PixelTensor(image);
  if (filter == ResizeFilter::kInterpolate) return Interpolate(PixelTensor(image), size);
  return PixelTensor(ResizeWithPad(image, static_cast<int>(size), static_cast<int>(size)));
}

}  // namespace robostress::openpi
