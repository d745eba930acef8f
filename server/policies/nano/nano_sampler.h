#pragma once

#include <torch/types.h>

#include <vector>

#include "server/policies/nano/nano_network.h"

namespace robostress {

// The ten Euler steps of a prediction without LibTorch's operators: the action expert is so small
// that they cost more than its arithmetic (a sample took 2-3 times as long). Same graph as
// NanoNetwork::Velocity, to rounding. What is the same in every prediction or step is computed
// once: pi0's state token's keys and values, the time's part of its action tokens, and pi05's
// modulations of the norms. Rows of a batch share each read of a matrix, and every kernel computes
// a row by the same operations in the same order whatever stands beside it, so a row's bits do not
// depend on the others. Immutable.
class NanoSampler {
 public:
  NanoSampler(const NanoConfig& config, const NanoParameters& parameters,
              const std::vector<float>& times);

  // noise [B, K, d], a context of B rows and an adapter for each row (null: none) -> chunks
  // [B, K, d].
  torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                       const std::vector<const LoraWeights*>& lora) const;

 private:
  struct Packed {  // weights [out, in] in panels, and the bias if there is one
    int64_t in = 0, out = 0;
    std::vector<float> panels, bias;
  };
  // y = x / rms(x) (1 + scale) + shift, and what multiplies the branch that follows; shift and gate
  // are empty for a plain norm.
  struct Norm {
    std::vector<float> scale, shift, gate;
  };
  struct Layer {
    Packed qkv, o, gate_up, down;
  };
  struct Lora;  // the adapter in the layout of the kernels
  struct Workspace;
  struct Item;
  enum class Tokens { kState, kAction };

  // Of one step: per layer the input and the post norm, then the final one.
  using StepNorms = std::vector<Norm>;

  static Packed Pack(const torch::Tensor& weight, const torch::Tensor& bias);
  void Apply(const Packed& packed, const float* x, int64_t rows, float* y) const;
  // Adds to each item's `rows` rows of y its adapter's part of targets first ... first + count - 1,
  // whose outputs lie side by side in y.
  void AddLora(const std::vector<Item>& items, size_t first, size_t count, const float* x,
               int64_t rows, float* y, int64_t width) const;
  // Runs the tokens of one kind of every item through the layers; their keys and values go to slots
  // first_slot ... of their item.
  void RunTokens(Workspace& work, const std::vector<Item>& items, Tokens kind, int64_t first_slot,
                 const StepNorms& norms) const;
  void EmbedActions(size_t step, const float* x, int64_t tokens, std::vector<float>& mixed,
                    Workspace& work) const;
  Item PutPrefix(const PolicyContext& context, int64_t row, size_t n, Workspace& work) const;
  // Rows first_row ... of the context, as many as there are adapters; x [rows, K, d] in place.
  void SampleTogether(const PolicyContext& context, int64_t first_row,
                      const std::vector<const Lora*>& lora, float* x) const;

  NanoConfig config_;
  std::vector<LoraTarget> lora_targets_;
  std::vector<float> times_;
  std::vector<std::vector<float>> time_bias_;  // pi0: per step [expert_width]
  std::vector<StepNorms> norms_;               // pi05: per step; pi0: one
  Packed state_, action_in_, time_in_, time_out_, action_out_;
  std::vector<Layer> layers_;
  std::vector<float> rope_cos_, rope_sin_;  // [positions, head_dim / 2]
};

}  // namespace robostress
