#pragma once

#include <cstdint>

#include "absl/types/span.h"
#include "common/safetensors.h"

namespace robostress::openpi {

// Index of the first element that is infinite or not a number, -1 without any. Reads the bits where
// they lie, aligned or not, and takes no memory. F32, BF16 and F16 only.
int64_t FirstNotFinite(DType dtype, absl::Span<const uint8_t> bytes);

}  // namespace robostress::openpi
