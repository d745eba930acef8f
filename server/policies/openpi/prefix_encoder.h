#pragma once

#include <torch/types.h>

#include "adapter/velocity_field.h"
#include "server/policies/openpi/flow.h"
#include "server/policies/openpi/inference_weights.h"
#include "server/policies/openpi/openpi_config.h"

namespace robostress::openpi {

// What predictions of one network share.
struct InferenceSetup {
  OpenpiConfig config;
  torch::Device device = torch::kCPU;
  torch::Dtype activations = torch::kFloat32;  // between layers
  torch::Dtype stored = torch::kFloat32;       // keys and values of a context

  AttentionShape shape() const { return {config.heads, config.kv_heads, config.head_dim}; }
};

// Images and prompt -> keys and values. Only what is valid is computed: SigLIP sees the cameras
// that are there, the prefix the tokens that are. Valid tokens of a row come first, in their order,
// so that a token's position, which counts valid tokens, is its index; rows shorter than the
// longest end in masked slots. Of the last layer only keys and values are computed. Each row has a
// valid token. Keys and values lie on the setup's device, the mask on the CPU.
PolicyContext EncodePrefix(const InferenceSetup& setup, const InferenceWeights& weights,
                           const ModelInputs& inputs);

// 0 where `mask` holds, else openpi's finite constant; [B, S] bool on the CPU -> [B, 1, S] on
// `device`.
torch::Tensor KeyMask(const torch::Tensor& mask, const torch::Device& device);

}  // namespace robostress::openpi
