#pragma once

#include <torch/types.h>

#include <utility>

namespace robostress {

// Differentiable forms of fused_kernels.h; float32, last dimension contiguous, first derivatives
// only.

// (x + delta, rms_norm(x + delta) (1 + weight)); delta may be undefined: then the first is x.
std::pair<torch::Tensor, torch::Tensor> AddRmsNorm(const torch::Tensor& x,
                                                   const torch::Tensor& delta,
                                                   const torch::Tensor& weight);

// gate_up [..., 2 m] -> gelu_tanh(gate) * up [..., m].
torch::Tensor GeGlu(const torch::Tensor& gate_up);

// qkv [rows, T, H h + 2 h] -> q [rows, T H, h] rotated and scaled, k [rows, T, h] rotated, v [rows,
// T, h]. cos, sin [positions, h/2]; position [rows T] int64.
struct Heads {
  torch::Tensor q, k, v;
};
Heads SplitRope(const torch::Tensor& qkv, const torch::Tensor& cos, const torch::Tensor& sin,
                const torch::Tensor& position, int64_t heads, double q_scale);

// softmax(scores + bias): scores [B, T H, S], overwritten; bias [B / draws, T or 1, S], without
// gradient.
torch::Tensor SoftmaxBias(torch::Tensor scores, const torch::Tensor& bias, int64_t heads);

}  // namespace robostress
