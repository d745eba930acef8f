#pragma once

#include <torch/types.h>

#include <cstddef>
#include <vector>

#include "server/policies/openpi/linear.h"

namespace robostress::openpi {

// Linear layers that read the same rows (q, k, v; gate, up). Their outputs lie side by side.
struct Projection {
  std::vector<Linear> parts;  // with the adapters that the network itself carries
  torch::Tensor weight;       // all parts in one matrix [out, in]; undefined: multiplied singly
  torch::Tensor bias;         // [out], of all parts
  torch::Tensor panels;  // `weight` packed for FusedKernels::linear, where Packed was asked for
  int64_t in = 0, out = 0;

  // One product instead of several saves calls, which matters while the product is small, and costs
  // a copy of the weights: parts are joined where that copy takes at most `limit_bytes`.
  static Projection Join(std::vector<Linear> parts, int64_t limit_bytes);

  // With a packed copy of `weight` where it is float32 on the CPU and takes at most `limit_bytes`:
  // for few rows, BLAS packs the weights anew in each product and spends a third of its time so.
  Projection Packed(int64_t limit_bytes) &&;
};

// Adapters of all targets, of one session for the whole batch or, with `rows`, one for each row of
// the batch (LoraRows). Empty: none.
struct Adapters {
  std::vector<torch::Tensor> A, B;
  bool rows = false;
};

// x [B T, in] -> [B T, out] in x's dtype: W x + b, plus the network's own adapter and those of
// targets first, first + 1, ... on parts 0, 1, ..., each computed beside W. The only place of
// inference that applies an adapter. Weights in bfloat16 under float32 rows are widened tile by
// tile, so that the product runs at the speed of float32. With adapters of rows, `batch` is B.
torch::Tensor Project(const Projection& projection, const torch::Tensor& x,
                      const Adapters& adapters = {}, size_t first = 0, int64_t batch = 1);

}  // namespace robostress::openpi
