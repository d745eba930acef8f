#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "adapter/velocity_field.h"

// Real-time chunking: the next chunk is made while the running one plays, and goes on from it
// (K. Black, M. Galliker, S. Levine, "Real-Time Execution of Action Chunking Flow Policies", 2025,
// arXiv:2506.07339, Eq. 2 to 5; the guidance is that of A. Pokle et al., "Training-free linear
// image inverses via flows", 2024). With u = 1 - tau, because 1 is noise here:
//
//   a_hat = x_u - u v(x_u, u)                       the chunk as it looks from here
//   g     = (d a_hat / d x_u)^T (W (Y - a_hat))     towards the running rows, through the network
//   w     = min(beta, ((1 - u)^2 + u^2) / (u (1 - u)))
//   x    <- x - (1/n) v + (1/n) w g                 each of the n Euler steps
//
//   W_i = 1                               i < held            will have been played: kept
//         c_i (e^c_i - 1) / (e - 1)       held <= i < rows    guide less and less,
//         0                               rows <= i           c_i = (rows - i) / (rows - held + 1)
//
// symbol  name        shape   unit
// Y       rows        [K, d]  model space; zero where W is
// W       weight      [K, d]  0 to 1
// beta    max_weight  -       bound of the guidance, which is infinite at u = 1
// n       times       -       Euler steps
namespace robostress {

// The paper's bound is 5 for 5 steps; for ten steps that of its clipped last step, 1 / u.
inline constexpr double kMaxGuidance = 10;

// W's column: [horizon], 0 <= held <= rows <= horizon.
torch::Tensor SoftMask(int64_t held, int64_t rows, int64_t horizon);

struct Guidance {
  torch::Tensor rows;    // Y [K, d]
  torch::Tensor weight;  // W [K, d]
  double max_weight = kMaxGuidance;
};

// Integrates from noise [1, K, d] over `times` (u of each step, 1 first) to a model-space chunk
// [1, K, d]. With W = 0 everywhere it is the plain Euler integration of `field`. Needs the
// gradient of v in x_u; no other gradient is kept.
torch::Tensor SampleGuided(const VelocityField& field, const PolicyContext& context,
                           const torch::Tensor& noise, const LoraWeights* lora,
                           const std::vector<float>& times, const Guidance& guidance);

}  // namespace robostress
