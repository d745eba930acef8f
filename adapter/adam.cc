#include "adapter/adam.h"

#include <torch/types.h>

#include <cmath>

#include "common/check.h"

namespace robostress {

AdamState InitialAdamState(const std::vector<torch::Tensor>& parameters) {
  AdamState state;
  for (const torch::Tensor& parameter : parameters) {
    state.m.push_back(torch::zeros_like(parameter));
    state.v.push_back(torch::zeros_like(parameter));
  }
  return state;
}

std::vector<torch::Tensor> AdamStep(const AdamOptions& options,
                                    const std::vector<torch::Tensor>& parameters,
                                    const std::vector<torch::Tensor>& gradients, AdamState& state) {
  RS_CHECK(parameters.size() == gradients.size() && parameters.size() == state.m.size());
  torch::NoGradGuard no_grad;
  ++state.steps;
  const double correction1 = 1 - std::pow(options.beta1, static_cast<double>(state.steps));
  const double correction2 = 1 - std::pow(options.beta2, static_cast<double>(state.steps));
  std::vector<torch::Tensor> result;
  for (size_t i = 0; i < parameters.size(); ++i) {
    const torch::Tensor& g = gradients[i];
    state.m[i] = options.beta1 * state.m[i] + (1 - options.beta1) * g;
    state.v[i] = options.beta2 * state.v[i] + (1 - options.beta2) * g * g;
    result.push_back(parameters[i] - options.learning_rate * (state.m[i] / correction1) /
                                         ((state.v[i] / correction2).sqrt() + options.epsilon));
  }
  return result;
}

double ClipGlobalNorm(std::vector<torch::Tensor>& gradients, double max_norm) {
  torch::NoGradGuard no_grad;
  double sum = 0;
  for (const torch::Tensor& g : gradients)
    sum += g.to(torch::kFloat64).square().sum().item<double>();
  const double norm = std::sqrt(sum);
  if (norm > max_norm) {
    for (torch::Tensor& g : gradients) g = g * (max_norm / norm);
  }
  return norm;
}

}  // namespace robostress
