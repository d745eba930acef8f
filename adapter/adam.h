#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

namespace robostress {

struct AdamOptions {
  double learning_rate = 1e-6;
  double beta1 = 0.9;
  double beta2 = 0.999;
  double epsilon = 1e-8;
};

// First and second moments, in the order of the parameters, and the number of steps taken.
struct AdamState {
  std::vector<torch::Tensor> m, v;
  int64_t steps = 0;
};

AdamState InitialAdamState(const std::vector<torch::Tensor>& parameters);

// One step of Adam (Kingma and Ba 2015, algorithm 1) without weight decay or schedule:
//   m <- beta1 m + (1 - beta1) g,  v <- beta2 v + (1 - beta2) g^2
//   p <- p - lr (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + epsilon)
// Returns new tensors; nothing that was passed in changes.
std::vector<torch::Tensor> AdamStep(const AdamOptions& options,
                                    const std::vector<torch::Tensor>& parameters,
                                    const std::vector<torch::Tensor>& gradients, AdamState& state);

// Scales the gradients to a joint L2 norm of at most `max_norm`: g <- g max_norm / ||g|| where
// ||g|| > max_norm. Returns the norm before.
double ClipGlobalNorm(std::vector<torch::Tensor>& gradients, double max_norm);

}  // namespace robostress
