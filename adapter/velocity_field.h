#pragma once

#include <torch/types.h>

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace robostress {

// A linear layer of the action expert that a LoRA may adapt, e.g. {"layers.0.q_proj", 128, 128, 4}.
struct LoraTarget {
  std::string name;
  int64_t in_features = 0;
  int64_t out_features = 0;
  int64_t output_heads = 1;  // q, k, v: the outputs lie head by head
  int64_t input_heads = 1;   // o: the inputs do; one of the two is 1
};

// LoRA parameters of every target, in the order of VelocityField::lora_targets(), in the shapes of
// LoraShapeOf (adapter/lora.h). Published snapshots are shared as const and never change.
struct LoraWeights {
  std::vector<torch::Tensor> A;  // [rank, in] or [heads, rank, in of a head]
  std::vector<torch::Tensor> B;  // [out, rank] or [heads, out of a head, rank]
  uint64_t version = 0;          // updates applied
};

// What the action expert needs of an observation: the prefix's keys and values (no adapter touches
// them) and the normalised proprioception. B rows.
struct PolicyContext {
  std::vector<torch::Tensor> keys;    // per layer [B, kv_heads, prefix, head_dim], after RoPE
  std::vector<torch::Tensor> values;  // per layer [B, kv_heads, prefix, head_dim]
  torch::Tensor prefix_mask;          // [B, prefix] bool
  torch::Tensor state;                // [B, state_dim] normalised
};

// What every context of a policy looks like, B = 1; one that was imported or read from a disk is
// held to it.
struct ContextShape {
  int64_t layers = 0, kv_heads = 0, head_dim = 0;
  torch::ScalarType kv_type = torch::kFloat32;  // of keys and values
  int64_t max_prefix = 0;                       // slots, at least 1
  int64_t state_dim = 0;                        // PolicyContext::state is [1, state_dim] float32
};

// INVALID_ARGUMENT names the tensor, what it is and what it must be: shapes, types, finite values,
// a mask of zeros and ones with at least one slot that counts. `where` begins the message.
absl::Status CheckContext(const std::string& where, const PolicyContext& context,
                          const ContextShape& shape);

// The adaptable part of a flow-matching policy (paper, Eq. flow-matching).
class VelocityField {
 public:
  virtual ~VelocityField() = default;
  virtual int64_t horizon() const = 0;           // K
  virtual int64_t model_action_dim() const = 0;  // d, padding included
  virtual const std::vector<LoraTarget>& lora_targets() const = 0;
  virtual ContextShape context_shape() const = 0;
  // v(s, x_u, u): x_u [B, K, d], u [B] in [0, 1] (1 is noise) -> [B, K, d]. Differentiable in the
  // LoRA parameters when they require gradients; lora may be null.
  virtual torch::Tensor Velocity(const PolicyContext& context, const torch::Tensor& x_u,
                                 const torch::Tensor& u, const LoraWeights* lora) const = 0;
};

// Concatenates contexts along the batch. Shorter prefixes are filled up with masked slots.
PolicyContext StackContexts(const std::vector<const PolicyContext*>& contexts);
// One row of a context, B = 1; shares storage.
PolicyContext ContextRow(const PolicyContext& context, int64_t row);

}  // namespace robostress
