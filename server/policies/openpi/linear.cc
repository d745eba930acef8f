#include "server/policies/openpi/linear.h"

#include <torch/torch.h>

namespace robostress::openpi {

torch::Tensor Apply(const Linear& linear, const torch::Tensor& x) {
  torch::Tensor y = at::linear(x.to(linear.weight.dtype()), linear.weight, linear.bias);
  if (!linear.lora_A.defined()) return y;
  const torch::Tensor low_rank =
      at::linear(x.to(linear.lora_A.dtype()), linear.lora_A);  // [..., rank]
  return y + (linear.lora_scale * at::linear(low_rank, linear.lora_B)).to(y.dtype());
}

}  // namespace robostress::openpi
