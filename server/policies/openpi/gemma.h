#pragma once

#include <torch/types.h>

#include <vector>

#include "server/policies/openpi/linear.h"

namespace robostress::openpi {

// Gemma's RMSNorm, y = x rsqrt(mean(x^2) + 1e-6) (1 + weight), or, where `dense` is defined, the
// adaptive one of pi0.5: scale, shift, gate = split(dense(cond)); y = x rsqrt(..) (1 + scale) +
// shift. Statistics in float32.
struct GemmaNorm {
  torch::Tensor weight;  // [w]
  Linear dense;          // [w -> 3 w]
};

// One pre-norm layer: x += gate1 * o(attention(norm(x))); x += gate2 * down(gelu_tanh(gate(y))
// up(y)), y = norm(x). The gates are those of the adaptive norms, otherwise 1. No biases.
struct GemmaLayer {
  GemmaNorm input_norm;
  Linear q, k, v, o;
  GemmaNorm post_norm;
  Linear gate, up, down;
};

// An expert: a transformer over its own tokens that shares attention with the other one.
struct GemmaStack {
  std::vector<GemmaLayer> layers;
  GemmaNorm norm;
};

// Sizes that both experts have in common.
struct AttentionShape {
  int64_t heads = 0, kv_heads = 0, head_dim = 0;
};

// Keys (after the rotation) and values of a prefix, per layer [B, kv_heads, P, head_dim].
struct KvCache {
  std::vector<torch::Tensor> keys, values;
};

// mask: [B, queries, keys] bool. positions: [B, queries] int64. cond: [B, w] for adaptive norms,
// else undefined. Embeddings and outputs [B, T, w]. Weights may be float32 or bfloat16: the
// residual stream and the cache have the type of the first layer's products; norms, rotation and
// softmax are computed in float32 and go back to it.

struct PrefixPass {
  torch::Tensor out_normed;  // after the final norm; actions do not depend on it
  KvCache cache;
};
PrefixPass RunPrefix(const GemmaStack& stack, const AttentionShape& shape,
                     const torch::Tensor& embeddings, const torch::Tensor& mask,
                     const torch::Tensor& positions);

// The suffix over a cached prefix, which it leaves unchanged; after the final norm.
torch::Tensor RunSuffix(const GemmaStack& stack, const AttentionShape& shape,
                        const torch::Tensor& embeddings, const torch::Tensor& cond,
                        const torch::Tensor& mask, const torch::Tensor& positions,
                        const KvCache& prefix);

// Both experts in one attention over [prefix | suffix]: the way of training. Returns the suffix
// after its final norm.
torch::Tensor RunJoint(const GemmaStack& prefix, const GemmaStack& expert,
                       const AttentionShape& shape, const torch::Tensor& prefix_embeddings,
                       const torch::Tensor& suffix_embeddings, const torch::Tensor& cond,
                       const torch::Tensor& mask, const torch::Tensor& positions);

}  // namespace robostress::openpi
