#include "server/policies/openpi/linear.h"

#include <torch/torch.h>

#include "adapter/lora.h"

namespace robostress::openpi {

torch::Tensor Apply(const Linear& linear, const torch::Tensor& x) {
  torch::Tensor y = at::linear(x, linear.weight, linear.bias);
  if (!linear.lora_A.defined()) return y;
  return y + linear.lora_scale * (linear.lora_rows ? LoraRowsDelta(x, linear.lora_A, linear.lora_B)
                                                   : LoraDelta(x, linear.lora_A, linear.lora_B));
}

}  // namespace robostress::openpi
