#include "robot_client/cameras/pixel_formats.h"

#include <algorithm>
#include <cctype>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr int kMaxSide = 4096;

uint8_t Clamp(int value) { return static_cast<uint8_t>(std::clamp(value, 0, 255)); }

// BT.601 in 16.16 fixed point: 255/219 for luma; 2 (1 - Kr) 255/224 and so on for chroma.
constexpr int kLuma = 76309, kRedV = 104597, kGreenU = 25675, kGreenV = 53279, kBlueU = 132201;

void PutPixel(int y, int u, int v, uint8_t* rgb) {
  const int luma = kLuma * (y - 16) + 32768;
  rgb[0] = Clamp((luma + kRedV * (v - 128)) >> 16);
  rgb[1] = Clamp((luma - kGreenU * (u - 128) - kGreenV * (v - 128)) >> 16);
  rgb[2] = Clamp((luma + kBlueU * (u - 128)) >> 16);
}

// The next decimal number of a PPM header, after white space and comments; -1 where there is none.
int TakeNumber(std::string_view& rest) {
  while (!rest.empty()) {
    if (rest.front() == '#') {
      const size_t end = rest.find('\n');
      rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
    } else if (std::isspace(static_cast<unsigned char>(rest.front()))) {
      rest.remove_prefix(1);
    } else {
      break;
    }
  }
  int value = -1;
  while (!rest.empty() && rest.front() >= '0' && rest.front() <= '9') {
    value = (value < 0 ? 0 : value) * 10 + (rest.front() - '0');
    if (value > 1'000'000) return -1;
    rest.remove_prefix(1);
  }
  return value;
}

}  // namespace

absl::StatusOr<Image> RgbFromYuyv(std::string_view bytes, int width, int height, int stride) {
  if (width < 2 || width % 2 != 0 || height < 1 || stride < 2 * width || width > kMaxSide ||
      height > kMaxSide ||
      bytes.size() < static_cast<size_t>(stride) * (height - 1) + size_t{2} * width) {
    return absl::InvalidArgumentError(absl::StrCat("a YUYV picture of ", width, " x ", height,
                                                   " with ", stride, " bytes a row does not fit ",
                                                   bytes.size(), " bytes"));
  }
  Image image{width, height, {}};
  image.data.resize(size_t{3} * width * height);
  const auto* data = reinterpret_cast<const uint8_t*>(bytes.data());
  for (int row = 0; row < height; ++row) {
    const uint8_t* in = data + static_cast<size_t>(row) * stride;
    uint8_t* out = image.data.data() + size_t{3} * row * width;
    for (int col = 0; col < width; col += 2, in += 4, out += 6) {
      PutPixel(in[0], in[1], in[3], out);
      PutPixel(in[2], in[1], in[3], out + 3);
    }
  }
  return image;
}

absl::StatusOr<Image> ParsePpm(const std::string& name, std::string_view bytes) {
  if (bytes.substr(0, 2) != "P6")
    return absl::InvalidArgumentError(absl::StrCat(name, ": not a binary PPM (P6)"));
  std::string_view rest = bytes.substr(2);
  const int width = TakeNumber(rest), height = TakeNumber(rest), largest = TakeNumber(rest);
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": size is ", width, " x ", height,
                                                   ", must be 1..", kMaxSide, " a side"));
  }
  if (largest != 255)
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": largest value is ", largest, ", must be 255"));
  const size_t expected = size_t{3} * width * height;
  if (rest.size() != expected + 1) {
    return absl::InvalidArgumentError(absl::StrCat(
        name, ": ", rest.size(), " bytes after the header, ", expected + 1, " were to come"));
  }
  Image image{width, height, {}};
  image.data.assign(rest.begin() + 1, rest.end());
  return image;
}

std::string FormatPpm(const Image& image) {
  std::string out = absl::StrCat("P6\n", image.width, " ", image.height, "\n255\n");
  out.append(reinterpret_cast<const char*>(image.data.data()), image.data.size());
  return out;
}

}  // namespace robostress
