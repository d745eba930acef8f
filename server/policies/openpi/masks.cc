#include "server/policies/openpi/masks.h"

#include <torch/types.h>

namespace robostress::openpi {

constexpr double kMasked = -2.3819763e38;

torch::Tensor BlockMask(const torch::Tensor& valid, const torch::Tensor& starts) {
  const torch::Tensor block = starts.to(torch::kInt64).cumsum(1);            // [B, T]
  const torch::Tensor reachable = block.unsqueeze(1) <= block.unsqueeze(2);  // [B, query, key]
  const torch::Tensor both_valid = valid.unsqueeze(1) & valid.unsqueeze(2);
  return reachable & both_valid;
}

torch::Tensor Positions(const torch::Tensor& valid) {
  return valid.to(torch::kInt64).cumsum(1) - 1;
}

torch::Tensor SuffixMask(const torch::Tensor& prefix_valid, const torch::Tensor& suffix_valid,
                         const torch::Tensor& suffix_starts) {
  const int64_t suffix = suffix_valid.size(1);
  const torch::Tensor to_prefix =
      prefix_valid.unsqueeze(1).expand({prefix_valid.size(0), suffix, prefix_valid.size(1)});
  return at::cat({to_prefix, BlockMask(suffix_valid, suffix_starts)}, 2);
}

torch::Tensor SuffixPositions(const torch::Tensor& prefix_valid,
                              const torch::Tensor& suffix_valid) {
  return prefix_valid.to(torch::kInt64).sum(1, /*keepdim=*/true) + Positions(suffix_valid);
}

torch::Tensor AdditiveMask(const torch::Tensor& mask) {
  return at::zeros(mask.sizes(), mask.options().dtype(torch::kFloat32))
      .masked_fill(mask.logical_not(), kMasked)
      .unsqueeze(1);
}

}  // namespace robostress::openpi
