#include "server/training/worst_case_actions.h"

#include <torch/autograd.h>
#include <torch/types.h>

#include "absl/strings/str_cat.h"

namespace robostress {

using torch::Tensor;

absl::Status ValidatePgdOptions(const PgdOptions& options) {
  const auto refuse = [](const char* name, double value, double low, double high) {
    return absl::InvalidArgumentError(
        absl::StrCat("training: robust.", name, " is ", value, ", must be ", low, " to ", high));
  };
  if (!(options.epsilon >= 0 && options.epsilon <= 10))
    return refuse("epsilon", options.epsilon, 0, 10);
  if (options.steps < 0 || options.steps > 1000) return refuse("steps", options.steps, 0, 1000);
  if (!(options.step_size > 0 && options.step_size <= 10))
    return refuse("step_size", options.step_size, 0, 10);
  return absl::OkStatus();
}

WorstCase FindWorstCaseActions(const NanoNetwork& network, const PolicyContext& context,
                               const Tensor& actions, const FlowDraw& draw,
                               const Tensor& step_weights, const PgdOptions& options) {
  WorstCase worst{actions.detach()};
  const int64_t action_dim = network.config().action_dim;
  Tensor delta = torch::zeros_like(worst.actions);
  for (int step = 0; step < options.steps; ++step) {
    Tensor moved = (worst.actions + delta).set_requires_grad(true);
    const Tensor loss = FlowLoss(network, context, moved, draw, step_weights);
    if (step == 0) worst.clean_loss = loss.item<double>();
    const Tensor gradient = torch::autograd::grad({loss}, {moved})[0];
    torch::NoGradGuard no_grad;
    delta.narrow(2, 0, action_dim)
        .add_(gradient.narrow(2, 0, action_dim).sign(), options.step_size)
        .clamp_(-options.epsilon, options.epsilon);
  }
  worst.actions = worst.actions + delta;
  return worst;
}

}  // namespace robostress
