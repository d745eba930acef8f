#include "common/image_resize.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace robostress {
namespace {

constexpr int kPrecisionBits = 32 - 8 - 2;  // Pillow's fixed point

// Weights of one output pixel: of `count` input pixels from `first` on.
struct Window {
  int first = 0;
  std::vector<int32_t> weights;
};

std::vector<Window> MakeWindows(int in, int out) {
  const double scale = static_cast<double>(in) / out;
  const double filter_scale = std::max(scale, 1.0);
  const double support = filter_scale;  // of the triangle
  std::vector<Window> windows(out);
  for (int x = 0; x < out; ++x) {
    const double centre = (x + 0.5) * scale;
    // Pillow rounds so.
    // NOLINTBEGIN(bugprone-incorrect-roundings)
    const int first = std::max(static_cast<int>(centre - support + 0.5), 0);
    const int last = std::min(static_cast<int>(centre + support + 0.5), in);
    // NOLINTEND(bugprone-incorrect-roundings)
    std::vector<double> weights(last - first);
    double sum = 0;
    for (int i = 0; i < last - first; ++i) {
      const double distance = std::abs((i + first - centre + 0.5) * (1.0 / filter_scale));
      weights[i] = distance < 1 ? 1 - distance : 0;
      sum += weights[i];
    }
    windows[x].first = first;
    for (double weight : weights) {
      const double scaled = (sum != 0 ? weight / sum : weight) * (1 << kPrecisionBits);
      windows[x].weights.push_back(static_cast<int32_t>(scaled + (scaled < 0 ? -0.5 : 0.5)));
    }
  }
  return windows;
}

uint8_t Clip(int32_t sum) {
  return static_cast<uint8_t>(std::clamp(sum >> kPrecisionBits, 0, 255));
}

}  // namespace

Image ResizeBilinear(const Image& image, int width, int height) {
  Image wide = image;
  if (width != image.width) {
    wide = Image{width, image.height, std::vector<uint8_t>(size_t{3} * width * image.height)};
    const std::vector<Window> windows = MakeWindows(image.width, width);
    for (int y = 0; y < image.height; ++y) {
      for (int x = 0; x < width; ++x) {
        for (int c = 0; c < 3; ++c) {
          int32_t sum = 1 << (kPrecisionBits - 1);
          const uint8_t* source = &image.data[3 * (size_t(y) * image.width + windows[x].first) + c];
          for (int32_t weight : windows[x].weights) {
            sum += weight * *source;
            source += 3;
          }
          wide.data[3 * (size_t(y) * width + x) + c] = Clip(sum);
        }
      }
    }
  }
  if (height == image.height) return wide;
  Image result{width, height, std::vector<uint8_t>(size_t{3} * width * height)};
  const std::vector<Window> windows = MakeWindows(image.height, height);
  const size_t row = size_t{3} * width;
  for (int y = 0; y < height; ++y) {
    for (size_t i = 0; i < row; ++i) {
      int32_t sum = 1 << (kPrecisionBits - 1);
      const uint8_t* source = &wide.data[windows[y].first * row + i];
      for (int32_t weight : windows[y].weights) {
        sum += weight * *source;
        source += row;
      }
      result.data[y * row + i] = Clip(sum);
    }
  }
  return result;
}

Image ResizeWithPad(const Image& image, int width, int height) {
  if (image.width == width && image.height == height) return image;
  const double ratio = std::max(static_cast<double>(image.width) / width,
                                static_cast<double>(image.height) / height);
  const int inner_width = std::max(1, static_cast<int>(image.width / ratio)),
            inner_height = std::max(1, static_cast<int>(image.height / ratio));
  const Image inner = ResizeBilinear(image, inner_width, inner_height);
  Image padded{width, height, std::vector<uint8_t>(size_t{3} * width * height, 0)};
  const int left = std::max(0, (width - inner_width) / 2),
            top = std::max(0, (height - inner_height) / 2);
  for (int y = 0; y < inner_height; ++y) {
    std::copy_n(inner.data.begin() + size_t{3} * y * inner_width, size_t{3} * inner_width,
                padded.data.begin() + 3 * (size_t(y + top) * width + left));
  }
  return padded;
}

}  // namespace robostress
