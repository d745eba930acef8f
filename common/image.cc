#include "common/image.h"

#include <png.h>
#include <webp/encode.h>
#include <webp/mux.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "common/check.h"

namespace robostress {
namespace {

// Overlap of output pixel `i` with input pixels: [first, last) and weights that sum to 1.
struct Overlap {
  int first = 0;
  std::vector<float> weights;
};

std::vector<Overlap> Overlaps(int in, int out) {
  std::vector<Overlap> result(out);
  const double ratio = static_cast<double>(in) / out;
  for (int i = 0; i < out; ++i) {
    const double low = i * ratio, high = (i + 1) * ratio;
    Overlap& o = result[i];
    o.first = static_cast<int>(low);
    for (int j = o.first; j < in && j < high; ++j) {
      o.weights.push_back(
          static_cast<float>((std::min<double>(j + 1, high) - std::max<double>(j, low)) / ratio));
    }
  }
  return result;
}

}  // namespace

Image ResizeArea(const Image& image, int width, int height) {
  RS_CHECK(width > 0 && height > 0);
  if (image.width == width && image.height == height) return image;
  const std::vector<Overlap> columns = Overlaps(image.width, width);
  const std::vector<Overlap> rows = Overlaps(image.height, height);
  std::vector<float> wide(static_cast<size_t>(image.height) * width * 3);
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        float sum = 0;
        for (size_t k = 0; k < columns[x].weights.size(); ++k) {
          sum +=
              columns[x].weights[k] * image.data[3 * (y * image.width + columns[x].first + k) + c];
        }
        wide[3 * (y * width + x) + c] = sum;
      }
    }
  }
  Image result{width, height, std::vector<uint8_t>(static_cast<size_t>(width) * height * 3)};
  for (int y = 0; y < height; ++y) {
    for (int i = 0; i < 3 * width; ++i) {
      float sum = 0;
      for (size_t k = 0; k < rows[y].weights.size(); ++k) {
        sum += rows[y].weights[k] * wide[3 * width * (rows[y].first + k) + i];
      }
      result.data[3 * width * y + i] =
          static_cast<uint8_t>(std::lround(std::clamp(sum, 0.0f, 255.0f)));
    }
  }
  return result;
}

Image MirrorColumns(const Image& image) {
  Image mirrored = image;
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      std::copy_n(image.data.begin() + 3 * (size_t(y) * image.width + image.width - 1 - x), 3,
                  mirrored.data.begin() + 3 * (size_t(y) * image.width + x));
    }
  }
  return mirrored;
}

Image HStack(const std::vector<Image>& images, int gap_px) {
  Image result;
  for (const Image& image : images) {
    result.width += image.width + (result.width > 0 ? gap_px : 0);
    result.height = std::max(result.height, image.height);
  }
  result.data.assign(static_cast<size_t>(result.width) * result.height * 3, 255);
  int left = 0;
  for (const Image& image : images) {
    for (int y = 0; y < image.height; ++y) {
      std::memcpy(&result.data[3 * (y * result.width + left)], &image.data[3 * y * image.width],
                  3 * image.width);
    }
    left += image.width + gap_px;
  }
  return result;
}

absl::StatusOr<std::string> EncodePng(const Image& image) {
  if (image.width <= 0 || image.height <= 0 ||
      image.data.size() != static_cast<size_t>(image.width) * image.height * 3) {
    return absl::InvalidArgumentError(absl::StrCat("image of ", image.width, " x ", image.height,
                                                   " has ", image.data.size(),
                                                   " bytes, not 3 per pixel"));
  }
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  png.width = image.width;
  png.height = image.height;
  png.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(png);
  std::string bytes(size, '\0');
  if (!png_image_write_to_memory(&png, bytes.data(), &size, 0, image.data.data(), 0, nullptr)) {
    return absl::InternalError(absl::StrCat("libpng: ", png.message));
  }
  bytes.resize(size);
  return bytes;
}

absl::StatusOr<Image> DecodePng(const std::string& bytes) {
  constexpr uint32_t kMostSide = 4096;
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  const auto failed = [&png](const char* what) {
    const std::string why = png.message;
    png_image_free(&png);
    return absl::InvalidArgumentError(absl::StrCat("PNG: ", why.empty() ? what : why));
  };
  if (!png_image_begin_read_from_memory(&png, bytes.data(), bytes.size())) return failed("damaged");
  if (png.width > kMostSide || png.height > kMostSide) return failed("larger than 4096 pixels");
  png.format = PNG_FORMAT_RGB;
  Image image{static_cast<int>(png.width), static_cast<int>(png.height), {}};
  image.data.resize(PNG_IMAGE_SIZE(png));
  constexpr png_color kBlack = {0, 0, 0};
  if (!png_image_finish_read(&png, &kBlack, image.data.data(), 0, nullptr))
    return failed("damaged");
  return image;
}

absl::StatusOr<std::string> EncodeAnimatedWebp(const std::vector<Image>& frames, double frame_s,
                                               float quality) {
  if (frames.empty()) return absl::InvalidArgumentError("a video needs at least one frame");
  WebPAnimEncoderOptions options;
  WebPAnimEncoderOptionsInit(&options);
  options.anim_params.loop_count = 0;
  options.kmax = 1000;
  options.kmin = 999;
  std::unique_ptr<WebPAnimEncoder, decltype(&WebPAnimEncoderDelete)> encoder(
      WebPAnimEncoderNew(frames[0].width, frames[0].height, &options), &WebPAnimEncoderDelete);
  WebPConfig config;
  WebPConfigInit(&config);
  config.quality = quality;
  config.method = 2;
  int64_t stamp_ms = 0;
  for (const Image& frame : frames) {
    WebPPicture picture;
    WebPPictureInit(&picture);
    picture.width = frame.width;
    picture.height = frame.height;
    picture.use_argb = 1;
    const bool added =
        frame.width == frames[0].width && frame.height == frames[0].height &&
        WebPPictureImportRGB(&picture, frame.data.data(), 3 * frame.width) &&
        WebPAnimEncoderAdd(encoder.get(), &picture, static_cast<int>(stamp_ms), &config);
    WebPPictureFree(&picture);
    if (!added)
      return absl::InternalError(absl::StrCat("WebP: ", WebPAnimEncoderGetError(encoder.get())));
    stamp_ms += std::lround(1000 * frame_s);
  }
  WebPAnimEncoderAdd(encoder.get(), nullptr, static_cast<int>(stamp_ms), nullptr);
  WebPData data;
  WebPDataInit(&data);
  if (!WebPAnimEncoderAssemble(encoder.get(), &data)) {
    return absl::InternalError(absl::StrCat("WebP: ", WebPAnimEncoderGetError(encoder.get())));
  }
  std::string bytes(reinterpret_cast<const char*>(data.bytes), data.size);
  WebPDataClear(&data);
  return bytes;
}

}  // namespace robostress
