#pragma once

#include <cstdint>
#include <vector>

#include "adapter/velocity_field.h"
#include "common/random.h"

namespace robostress {

// phi_0: A ~ N(0, init_std^2), drawn from `session` and the target's name, so a function of these
// alone; B = 0, so the adapted policy equals the base policy (paper, sec:supp_lora).
LoraWeights InitialLora(const std::vector<LoraTarget>& targets, int64_t rank, double init_std,
                        const StreamKey& session);

// A_0, B_0, A_1, B_1, ...: the order of gradients and Adam moments.
std::vector<torch::Tensor> Parameters(const LoraWeights& lora);
// The inverse of Parameters.
LoraWeights FromParameters(const std::vector<torch::Tensor>& parameters, uint64_t version);

// ||phi - phi_0||_2 over all A and B.
double LoraDistance(const LoraWeights& phi, const LoraWeights& phi_0);
int64_t NumParameters(const LoraWeights& lora);

}  // namespace robostress
