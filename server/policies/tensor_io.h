#pragma once

#include <torch/types.h>

#include <string>

#include "absl/status/statusor.h"
#include "common/safetensors.h"

namespace robostress::openpi {

// "[2, 50, 32]", as messages show shapes.
std::string ShapeText(c10::IntArrayRef shape);

// Float types are widened to float32, integers to int64, BOOL becomes bool. Copies; an error names
// `what` and the dtype.
absl::StatusOr<torch::Tensor> ToTensor(const std::string& what, const TensorView& view);

// The same for a tensor of numbers: F32, BF16 or F16, and every value finite.
absl::StatusOr<torch::Tensor> ToFiniteFloats(const std::string& what, const TensorView& view);

}  // namespace robostress::openpi
