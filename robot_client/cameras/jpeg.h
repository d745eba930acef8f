#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// A picture of a camera's Motion-JPEG. Trusts nothing: at most 4096 pixels a side. DATA_LOSS where
// it is cut off or damaged; the stray bytes before a marker that many webcams send are no damage.
absl::StatusOr<Image> RgbFromJpeg(std::string_view bytes);

// `quality` 1..100.
absl::StatusOr<std::string> JpegFromRgb(const Image& image, int quality = 85);

}  // namespace robostress
