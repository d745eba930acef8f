#pragma once

#include <torch/types.h>

#include "server/policies/openpi/gemma.h"

namespace robostress::openpi {

// What happens between the products of a layer, for inference only. Each is one pass: on the CPU
// in float32 (fused_kernels.h), on a GPU where the build has CUDA's compiler (gpu_kernels.h).
// Elsewhere LibTorch's operators; statistics and angles are float32.

// y = x rsqrt(mean(x^2) + 1e-6) (1 + scale) + shift, scale and shift [w], shift may be undefined;
// gate [w] multiplies the branch that follows, undefined: 1.
struct Modulation {
  torch::Tensor scale, shift, gate;
};

// x += gate branch (where defined), then the norm of x. x [rows, w] is changed in place, and
// branch [rows, w] may be. gate [w] is the modulation's before the branch, undefined: 1.
torch::Tensor AddAndNormalise(torch::Tensor& x, torch::Tensor branch, const torch::Tensor& gate,
                              const Modulation& modulation);

// [rows, 2 m], gate and up side by side -> gelu_tanh(gate) * up [rows, m].
torch::Tensor GeGlu(const torch::Tensor& gate_up);

// gelu_tanh(x), in place.
void Gelu(torch::Tensor& x);

// cos and sin of the rotary angles, a row per token: [rows, head_dim / 2]; rows is 0, 1, ... .
struct Rotary {
  torch::Tensor cos, sin, rows;
};
// positions [rows] int64.
Rotary MakeRotary(const torch::Tensor& positions, int64_t head_dim);

// Rows of q (`heads` of them, 0 too), k and v side by side, [B T, (heads + 2 kv_heads) h], become
// q [B kv_heads, T group, h], divided by sqrt(h), k [B kv_heads, T, h] and v. q and k are rotated
// where `rotary` is given.
struct Heads {
  torch::Tensor q, k, v;
};
Heads SplitHeads(const torch::Tensor& qkv, int64_t batch, const AttentionShape& shape,
                 int64_t heads, const Rotary* rotary);

// softmax(q k^T + mask) v -> [B T, heads h]. k, v [B kv_heads, S, h]; mask [B or 1, T or 1, S]
// float32, undefined: every query sees every key.
torch::Tensor Attend(const torch::Tensor& q, const torch::Tensor& k, const torch::Tensor& v,
                     const torch::Tensor& mask, int64_t batch, const AttentionShape& shape);

}  // namespace robostress::openpi
