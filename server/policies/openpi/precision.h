#pragma once

#include <torch/types.h>

#include <string>

#include "absl/status/statusor.h"
#include "server/policies/openpi/openpi_weights.h"

namespace robostress::openpi {

// How the large matrices are stored and multiplied.
enum class Precision { kFloat32, kBf16 };

// "cpu", "cuda" or "cuda:N". FailedPrecondition where it is not there.
absl::StatusOr<torch::Device> FindDevice(const std::string& name);

// Whether matrix products of bfloat16 run in hardware: on a GPU, or AMX or AVX512-BF16 on a CPU.
// Elsewhere LibTorch emulates them at 1.5 GFLOP/s, 40 times slower than float32.
bool MultipliesBf16(const torch::Device& device);

// Dtypes of a network in use. Always float32: patch and position embedding, norms of the
// transformers and their adaptive projections, projections of state, actions and time (openpi's
// selection). The other matrices take `matrices`; their biases and SigLIP's norms are rounded to
// that, then stored as `activations`.
struct Dtypes {
  torch::Dtype matrices = torch::kFloat32;
  torch::Dtype activations = torch::kFloat32;  // between layers, and of keys and values in use
};

// `model` in these dtypes on `device`. Tensors that fit already are shared; each other one is
// converted alone, so that a model that is moved in never exists twice as a whole.
OpenpiModel ConvertModel(OpenpiModel model, const Dtypes& dtypes, const torch::Device& device);

// `model` with the action expert in float32, which is what learns and where gradients pass; for
// processors that multiply bfloat16 slowly. Takes memory for the expert alone, 1.2 GB at full size.
OpenpiModel WithFloat32Expert(OpenpiModel model);

}  // namespace robostress::openpi
