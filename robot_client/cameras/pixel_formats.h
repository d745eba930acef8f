#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// YUYV 4:2:2 as cameras deliver it to RGB (ITU-R BT.601, limited range: Y 16..235, U and
// V 16..240). `stride` bytes per row, at least 2 * width; `width` is even. INVALID_ARGUMENT when
// the bytes do not hold that many rows.
absl::StatusOr<Image> RgbFromYuyv(std::string_view bytes, int width, int height, int stride);

// A binary PPM (P6, 8 bits). Trusts nothing: the error names `name`, field and value. At most 4096
// pixels a side.
absl::StatusOr<Image> ParsePpm(const std::string& name, std::string_view bytes);
std::string FormatPpm(const Image& image);

}  // namespace robostress
