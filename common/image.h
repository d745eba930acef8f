#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// Exact box average when the size divides evenly, else area-weighted average.
Image ResizeArea(const Image& image, int width, int height);
// Left and right exchanged.
Image MirrorColumns(const Image& image);
Image HStack(const std::vector<Image>& images, int gap_px);
absl::StatusOr<std::string> EncodePng(const Image& image);
// RGB, without alpha. INVALID_ARGUMENT: no PNG, damaged, or of more than 4096 pixels a side.
absl::StatusOr<Image> DecodePng(const std::string& bytes);
// Animated lossy WebP, endless loop; frames of one size.
absl::StatusOr<std::string> EncodeAnimatedWebp(const std::vector<Image>& frames, double frame_s,
                                               float quality);

}  // namespace robostress
