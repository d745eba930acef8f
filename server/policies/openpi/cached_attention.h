#pragma once

#include <torch/types.h>

namespace robostress::openpi {

// softmax(q k^T / sqrt(h) + mask) v over the keys [prefix | suffix] for an update: the prefix is
// stored and nothing of it learns, so that gradients go to q, k and v alone. Scores are made once
// and overwritten by the weights, which backward reads. Float32 on the CPU, first derivatives only.
// q [B, heads, T, h]; k, v [B, kv_heads, T, h]; prefix_k, prefix_v [B, kv_heads, P, h]; mask
// [B, 1, T, P + T] additive -> [B, T, heads h]. Query head i reads key head i / (heads / kv_heads).
torch::Tensor AttendToStored(const torch::Tensor& q, const torch::Tensor& k, const torch::Tensor& v,
                             const torch::Tensor& prefix_k, const torch::Tensor& prefix_v,
                             const torch::Tensor& mask);

}  // namespace robostress::openpi
