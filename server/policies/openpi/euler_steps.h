#pragma once

#include <torch/types.h>

#include <vector>

#include "server/policies/openpi/prefix_encoder.h"

namespace robostress::openpi {

// The memory of one prediction. Its addresses stay, so that a recorded graph can run over it again.
struct StepBuffers {
  // Per layer [B kv_heads, prefix + suffix, h]. The prefix part is written once, the suffix part by
  // each step.
  std::vector<torch::Tensor> keys, values;
  torch::Tensor mask;         // [B or 1, S or 1, prefix + suffix] additive; undefined: all is seen
  torch::Tensor cos, sin;     // [B S, h / 2]
  torch::Tensor rows;         // [B S] 0, 1, ...
  torch::Tensor state_token;  // [B, 1, w] float32; pi0
  torch::Tensor x;            // [B, K, d] float32: noise, then the actions
  Adapters adapters;
};

// Everything that decides the sizes of the buffers and the operations of a prediction.
struct StepShape {
  int64_t batch = 0, prefix = 0;
  bool masked = false;  // a mask over the prefix
  bool rows = false;    // an adapter for each row
  std::vector<std::vector<int64_t>>
      adapter;  // sizes of A and B of each target in turn; empty: none
  auto operator<=>(const StepShape&) const =
      default;  // NOLINT(modernize-use-nullptr): its own zero
};

// Shape of a prediction with at least `prefix` slots for the prefix.
StepShape ShapeOfPrediction(const PolicyContext& context, const Adapters& adapters, int64_t prefix);
StepBuffers AllocateSteps(const InferenceSetup& setup, const StepShape& shape);
// Copies what a prediction reads into its buffers.
void FillSteps(const InferenceSetup& setup, const InferenceWeights& weights,
               const PolicyContext& context, const torch::Tensor& noise, const Adapters& adapters,
               StepBuffers& buffers);
// x becomes the actions: x -= v(x, t) / steps at each of `steps` times. Reads and writes the
// buffers alone and never waits for the device.
void RunSteps(const InferenceSetup& setup, const InferenceWeights& weights, int64_t steps,
              StepBuffers& buffers);

}  // namespace robostress::openpi
