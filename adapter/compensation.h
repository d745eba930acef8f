#pragma once

#include <vector>

#include "adapter/lora.h"
#include "adapter/velocity_field.h"
#include "common/random.h"

// The compensation loss (paper, Eq. flow-matching):
//
//   L = mean over b of 1/(K d) ||v(s_b, a_b^u, u) - (eps - a_b)||^2  +  lambda ||phi - phi_0||^2
//   a_b^u = u eps + (1 - u) a_b
//
// symbol   name            shape      unit
// a_b      targets         [B, K, d]  model space (normalised, padded)
// eps      FlowDraw::eps   [K, d]     N(0, 1); one per update, shared by the batch
// u        FlowDraw::u     scalar     Uniform(0, 1) flow-matching time (not the training's Beta); 1
// is noise lambda   anchor_weight   scalar     the anchor is a sum over the parameters, not a mean
namespace robostress {

// The one Monte-Carlo sample of an update.
struct FlowDraw {
  double u = 0;
  torch::Tensor eps;  // [K, d] float32
};
// A function of (session, update index) alone.
FlowDraw DrawFlow(const StreamKey& session, uint64_t update, int64_t horizon, int64_t action_dim);

// The pseudo-target chunk in model space [K, d]: `raw` with the rows from `first_step` on replaced
// by `corrected` [n, action_dim] (ToModel of the environment pseudo-target) in the first action_dim
// - 1 columns. Gripper, padding and rows that were not executed keep the bits of `raw`.
torch::Tensor TargetChunk(const torch::Tensor& raw, int64_t first_step,
                          const torch::Tensor& corrected);

// L; differentiable in `phi` where its tensors require gradients.
torch::Tensor CompensationLoss(const VelocityField& field, const PolicyContext& context,
                               const torch::Tensor& targets, const FlowDraw& draw,
                               const LoraWeights& phi, const LoraWeights& phi_0,
                               double anchor_weight);

}  // namespace robostress
