#pragma once

#include <torch/types.h>

#include <map>
#include <string>

#include "absl/status/statusor.h"
#include "common/safetensors.h"
#include "server/policies/openpi/openpi_weights.h"

namespace robostress::openpi {

// An adapter of some linear layers, W' = W + scale B A: one pair per matrix, as PEFT has it.
// (openpi's JAX adapters factor q, k, v and o per head: those must be merged, not copied.)
struct OpenpiLora {
  struct Pair {
    torch::Tensor A;  // [rank, in]
    torch::Tensor B;  // [out, rank]
  };
  std::map<std::string, Pair> pairs;  // by openpi's name of the layer, without ".weight"
  double scale = 1;
};

// Reads `lora/<layer>.lora_{A,B}.weight` and metadata `scale` (absent: 1) and `rank` (a check
// only). The error lists every pair that is half, misshaped or names no linear layer of `config`.
absl::StatusOr<OpenpiLora> LoadOpenpiLora(const SafetensorsFile& file, const OpenpiConfig& config);

// `model` with the adapter on its layers. All tensors are shared, none is changed or merged. A
// layer that the model lacks is a programmer's error.
OpenpiModel WithLora(OpenpiModel model, const OpenpiLora& lora);

}  // namespace robostress::openpi
