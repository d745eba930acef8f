#pragma once

#include <torch/types.h>

namespace robostress::openpi {

// y = W x + b + scale B A x. Bias and adapter are undefined where there is none.
struct Linear {
  torch::Tensor weight;  // W [out, in]
  torch::Tensor bias;    // b [out]
  torch::Tensor lora_A;  // A [rank, in]
  torch::Tensor lora_B;  // B [out, rank]
  double lora_scale = 1;
};

// x [..., in] -> [..., out] in the type of W; the adapter is computed in its own type beside W,
// never merged into it.
torch::Tensor Apply(const Linear& linear, const torch::Tensor& x);

}  // namespace robostress::openpi
