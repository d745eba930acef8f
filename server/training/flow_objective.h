#pragma once

#include <torch/types.h>

#include <cstdint>

#include "server/policies/nano/nano_network.h"

namespace robostress {

// Noise and flow times of a batch: `draws` of them for each row.
struct FlowDraw {
  torch::Tensor noise;  // e, [rows draws, K, d]
  torch::Tensor t;      // [rows draws]
};

// e ~ N(0, 1); t = 0.999 Beta(1.5, 1) + 0.001 as in openpi, stratified over the draws of a row. The
// quantile of Beta(1.5, 1) is u^(1/1.5).
FlowDraw DrawFlow(int64_t rows, int64_t draws, const NanoConfig& config, uint64_t seed);

// The flow-matching loss of action chunks a [rows, K, d], normalised:
//   mean_w ( v(s, t e + (1 - t) a, t) - (e - a) )^2,
// w = step_weights [K, 1] of mean 1. Row i of context and actions serves draws i n ... i n + n - 1.
// Differentiable in the network's parameters, the context and the actions.
torch::Tensor FlowLoss(const NanoNetwork& network, const PolicyContext& context,
                       const torch::Tensor& actions, const FlowDraw& draw,
                       const torch::Tensor& step_weights);

}  // namespace robostress
