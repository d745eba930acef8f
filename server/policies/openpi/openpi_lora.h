#pragma once

#include <torch/types.h>

#include <map>
#include <string>

#include "absl/status/statusor.h"
#include "adapter/lora.h"
#include "common/safetensors.h"
#include "server/policies/openpi/openpi_weights.h"

namespace robostress::openpi {

// What online adaptation changes (paper, sec:supp_lora): q, k, v, o, gate, up, down of every layer
// of the action expert, under openpi's names of the layers. At full size and rank 4: 2,764,800
// parameters per head, 1,732,608 per matrix.
std::vector<LoraTarget> ExpertLoraTargets(const OpenpiConfig& config);

// `model` with an adapter in the order of ExpertLoraTargets, or with one for each row of a batch.
// All tensors are shared, none is changed or merged. With rows, every input of the model has as
// many.
OpenpiModel WithLora(OpenpiModel model, const LoraWeights& lora);
OpenpiModel WithLora(OpenpiModel model, const LoraRows& lora);

// The oracle's adapter of some linear layers, W' = W + scale B A: one pair per matrix, as PEFT has
// it.
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
