#pragma once

#include <torch/types.h>

namespace robostress::openpi {

// y = W x + b + scale B A x. Bias and adapter are undefined where there is none. The adapter is a
// pair of either kind (adapter/lora.h), or one pair of matrices for each row of a batch.
struct Linear {
  torch::Tensor weight;  // W [out, in]
  torch::Tensor bias;    // b [out]
  torch::Tensor lora_A;  // [rank, in], [heads, rank, in of a head]; of rows [B, rank, in]
  torch::Tensor lora_B;  // [out, rank], [heads, out of a head, rank]; of rows [B, out, rank]
  bool lora_rows = false;
  double lora_scale = 1;
};

// x [..., in], with an adapter of rows [B, T, in] -> [..., out] in the type of W; the adapter is
// computed in its own type beside W,
// never merged into it.
torch::Tensor Apply(const Linear& linear, const torch::Tensor& x);

}  // namespace robostress::openpi
