#pragma once

#include <torch/types.h>

namespace robostress::openpi {

// The rule of pi0 and PaliGemma: tokens come in blocks, `starts` marks the first of each. A query
// sees a key when the key's block is not later than its own and both are valid. Within a block
// attention is bidirectional.
// valid, starts [B, T] bool -> [B, T, T] bool, rows are queries.
torch::Tensor BlockMask(const torch::Tensor& valid, const torch::Tensor& starts);

// Valid tokens before and including each, minus one: padding repeats the position before it, -1 at
// the very front. valid [B, T] bool -> [B, T] int64.
torch::Tensor Positions(const torch::Tensor& valid);

// The same two for a suffix over a cached prefix: [B, S, P + S] and [B, S].
torch::Tensor SuffixMask(const torch::Tensor& prefix_valid, const torch::Tensor& suffix_valid,
                         const torch::Tensor& suffix_starts);
torch::Tensor SuffixPositions(const torch::Tensor& prefix_valid, const torch::Tensor& suffix_valid);

// 0 where `mask` holds, else -2.3819763e38, openpi's constant: a finite value keeps rows without
// any key finite (a uniform average), which -inf would not. [B, T, S] bool -> [B, 1, T, S] float32.
torch::Tensor AdditiveMask(const torch::Tensor& mask);

}  // namespace robostress::openpi
