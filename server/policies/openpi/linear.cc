#include "server/policies/openpi/linear.h"

#include <torch/types.h>

#include "adapter/lora.h"

namespace robostress::openpi {

torch::Tensor Apply(const Linear& linear, const torch::Tensor& x) {
  torch::Tensor y = at::linear(x.to(linear.weight.dtype()), linear.weight, linear.bias);
  if (!linear.lora_A.defined()) return y;
  const torch::Tensor wide = x.to(linear.lora_A.dtype());
  const torch::Tensor delta = linear.lora_rows ? LoraRowsDelta(wide, linear.lora_A, linear.lora_B)
                                               : LoraDelta(wide, linear.lora_A, linear.lora_B);
  return y + (linear.lora_scale * delta).to(y.dtype());
}

}  // namespace robostress::openpi
