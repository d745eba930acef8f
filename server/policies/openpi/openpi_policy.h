#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/policies/openpi/openpi_weights.h"
#include "server/policies/openpi/preprocessor.h"
#include "server/policies/policy.h"

namespace robostress::openpi {

// pi0 or pi0.5 as a policy. LoRA targets: ExpertLoraTargets (openpi_lora.h).
// Predicts by OpenpiInference; Velocity, where gradients are wanted, is the reference. Contexts lie
// on the options' device; what an adapter reads and writes lies on the CPU.
absl::StatusOr<std::unique_ptr<FlowPolicy>> MakeOpenpiPolicy(
    OpenpiModel model, std::unique_ptr<const Preprocessor> preprocessor,
    const PolicyOptions& options, const std::string& name, const std::string& model_hash);

// Serves a checkpoint under the name `path`, or the one of the options. In this order, and each
// before memory is taken for the next: options, tensors of all shards, norm stats and everything
// else of the setup (all problems in one message), tokenizer, weights. The hash covers shards,
// statistics and setup, but neither device nor threads, which change rounding alone.
absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadOpenpiPolicy(
    const std::string& path, const std::vector<std::string>& options);

}  // namespace robostress::openpi
