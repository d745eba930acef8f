#include "robot_client/cameras/jpeg.h"

#include <turbojpeg.h>

#include <memory>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr int kMaxSide = 4096;

struct DestroyHandle {
  void operator()(void* handle) const { tjDestroy(handle); }
};
using Handle = std::unique_ptr<void, DestroyHandle>;

// Whether the picture is good in spite of what the decoder said.
bool OnlyStrayBytes(tjhandle handle) {
  return tjGetErrorCode(handle) == TJERR_WARNING &&
         absl::StrContains(tjGetErrorStr2(handle), "extraneous bytes before marker");
}

}  // namespace

absl::StatusOr<Image> RgbFromJpeg(std::string_view bytes) {
  const Handle handle(tjInitDecompress());
  if (handle == nullptr) return absl::InternalError("no JPEG decoder");
  const auto* data = reinterpret_cast<const unsigned char*>(bytes.data());
  int width = 0, height = 0, sampling = 0, colours = 0;
  const auto damaged = [&] {
    return absl::DataLossError(absl::StrCat("a JPEG picture of ", bytes.size(),
                                            " bytes is damaged: ", tjGetErrorStr2(handle.get())));
  };
  if (tjDecompressHeader3(handle.get(), data, bytes.size(), &width, &height, &sampling, &colours) <
          0 &&
      !OnlyStrayBytes(handle.get()))
    return damaged();
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    return absl::DataLossError(absl::StrCat("a JPEG picture is ", width, " x ", height,
                                            ", must be 1..", kMaxSide, " a side"));
  }
  Image image{width, height, {}};
  image.data.resize(size_t{3} * width * height);
  if (tjDecompress2(handle.get(), data, bytes.size(), image.data.data(), width, 0, height, TJPF_RGB,
                    TJFLAG_LIMITSCANS) < 0 &&
      !OnlyStrayBytes(handle.get()))
    return damaged();
  return image;
}

absl::StatusOr<std::string> JpegFromRgb(const Image& image, int quality) {
  const Handle handle(tjInitCompress());
  if (handle == nullptr) return absl::InternalError("no JPEG encoder");
  unsigned char* out = nullptr;
  unsigned long length = 0;
  const int result = tjCompress2(handle.get(), image.data.data(), image.width, 0, image.height,
                                 TJPF_RGB, &out, &length, TJSAMP_420, quality, 0);
  std::string bytes(reinterpret_cast<char*>(out), result < 0 ? 0 : length);
  tjFree(out);
  if (result < 0) {
    return absl::InternalError(absl::StrCat("a picture of ", image.width, " x ", image.height,
                                            " became no JPEG: ", tjGetErrorStr2(handle.get())));
  }
  return bytes;
}

}  // namespace robostress
