#pragma once

#include <torch/types.h>

#include "absl/status/status.h"
#include "server/training/flow_objective.h"

namespace robostress {

// Projected gradient descent (PGD, Madry et al. 2018) on a demonstration, in an l-infinity ball.
struct PgdOptions {
  double epsilon = 0.03;     // radius of the ball, in standard deviations of the action dimension
  int steps = 3;             // 0: the demonstration itself, which is behaviour cloning
  double step_size = 0.015;  // of a signed step

  template <class V>
  void Visit(V& v) {
    v.Field("epsilon", epsilon, "radius of the l-infinity ball around the normalised chunk");
    v.Field("steps", steps, "gradient steps; 0: behaviour cloning");
    v.Field("step_size", step_size, "length of a signed step");
  }
};

absl::Status ValidatePgdOptions(const PgdOptions& options);

// What PGD found.
struct WorstCase {
  torch::Tensor actions;  // a + delta, [rows, K, d], without gradient
  double clean_loss = 0;  // the flow loss at delta = 0
};

// The inner maximisation of RobustVLA (Guo et al. 2025) as this project reads the paper's "trains
// adversarially within an l-infinity ball, epsilon = 0.03, PGD": the demonstrated chunk a itself is
// perturbed, so that both the point on the flow and the target move with it,
//   max_{|delta|_inf <= epsilon}  mean_w ( v(s, t e + (1-t)(a + delta), t) - (e - (a + delta)) )^2,
//   delta_0 = 0,   delta_{i+1} = clip( delta_i + step_size sign(grad), -epsilon, epsilon ).
// One delta per frame, shared by its draws of (t, e); padding channels (from `action_dim` on) stay
// 0. The start is the demonstration, where the gradient of a squared error does not vanish, and
// gives the clean loss at no cost. `context` holds stored keys and values: the prefix is computed
// once per frame, and no step differentiates through it. `network` should be of parameters without
// gradients, which saves their share of the work. With no steps clean_loss is 0: nothing was
// computed.
WorstCase FindWorstCaseActions(const NanoNetwork& network, const PolicyContext& context,
                               const torch::Tensor& actions, const FlowDraw& draw,
                               const torch::Tensor& step_weights, const PgdOptions& options);

}  // namespace robostress
