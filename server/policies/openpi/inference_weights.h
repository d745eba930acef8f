#pragma once

#include <torch/types.h>

#include <vector>

#include "server/policies/openpi/layer_ops.h"
#include "server/policies/openpi/openpi_weights.h"
#include "server/policies/openpi/projection.h"

namespace robostress::openpi {

// A network prepared for predictions: q, k, v and gate, up joined where small, and everything that
// is the same in each prediction computed once.
struct InferenceLayer {
  Projection qkv;  // of the last prefix layer only k, v: nobody reads what follows them
  Projection o, gate_up, down;
};

struct InferenceStack {
  std::vector<InferenceLayer> layers;
  // [step][2 layers + 1]: of each layer before attention and before the MLP, then the final one.
  // Norms that do not depend on the time have one step.
  std::vector<std::vector<Modulation>> norms;

  const std::vector<Modulation>& NormsAt(size_t step) const {
    return norms[norms.size() == 1 ? 0 : step];
  }
};

struct VisionLayer {
  LayerNorm norm1, norm2;
  Projection qkv, out, fc1, fc2;
};

struct InferenceWeights {
  torch::Tensor patch_weight, patch_bias, position;
  std::vector<VisionLayer> vision;
  LayerNorm vision_norm;
  Projection projector;
  torch::Tensor embedding;
  InferenceStack prefix, expert;
  Projection action_in, action_out, state;
  Projection time_in;   // pi0: the columns of action_time_mlp_in that read the action
  Projection time_out;  // pi0
  // pi0: what the time adds to action_time_mlp_in, its columns of the time and its bias: [steps, w]
  torch::Tensor time_bias;
};

// Flow-matching times of `steps` Euler steps, summed in float32 from 1 as openpi does (flow.h).
std::vector<float> EulerTimes(int64_t steps);

// `model` at those times. Joins matrices of at most `join_limit_bytes` together. Tensors are shared
// with `model`; pi0.5's projections of the adaptive norms are not kept.
InferenceWeights PrepareWeights(const OpenpiModel& model, const std::vector<float>& times,
                                torch::Dtype activations, int64_t join_limit_bytes);

}  // namespace robostress::openpi
