#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/velocity_field.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"

namespace robostress {

// A flow-matching policy: observation -> context (once), context + noise -> action chunk (ten Euler steps).
// Immutable after construction; const methods may run on several threads at once.
class FlowPolicy : public VelocityField {
 public:
  virtual const PolicySpec& spec() const = 0;
  // Checks cameras, sizes and state, resizes, tokenises, normalises, runs the prefix. B = 1.
  virtual absl::StatusOr<PolicyContext> Encode(const Observation& observation) const = 0;
  // Integrates from noise [B, K, d] (float32) to model-space chunks [B, K, d].
  virtual torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                               const LoraWeights* lora) const = 0;
  // Model-space chunk [K, d] -> environment actions [K, action_dim], and back for rows [n, action_dim] ->
  // [n, action_dim] with the training's transforms. `context` is that of the chunk's prediction: actions
  // may be relative to the state at the chunk's start.
  virtual Eigen::MatrixXf ToEnvironment(const torch::Tensor& chunk,
                                        const PolicyContext& context) const = 0;
  virtual torch::Tensor ToModel(const Eigen::MatrixXf& actions,
                                const PolicyContext& context) const = 0;
};

// Loads a policy by name: "nano" (embedded weights) or a path to weights. `options` are KEY=VALUE of
// policies/openpi/policy_options.h, for a pi0 or pi0.5 checkpoint.
absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadFlowPolicy(
    const std::string& name_or_path, const std::vector<std::string>& options = {});

}  // namespace robostress
