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

// A flow-matching policy: observation -> context (once), context + noise -> action chunk (ten Euler
// steps). Immutable after construction; const methods may run on several threads at once.
class FlowPolicy : public VelocityField {
 public:
  virtual const PolicySpec& spec() const = 0;
  // Checks cameras, sizes and state, resizes, tokenises, normalises, runs the prefix. B = 1.
  virtual absl::StatusOr<PolicyContext> Encode(const Observation& observation) const = 0;
  // Integrates from noise [B, K, d] (float32) to model-space chunks [B, K, d].
  virtual torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                               const LoraWeights* lora) const = 0;
  // As Sample, each row with its own adapter (null: none), none of them merged: robots with
  // different adapters share one batch. Row i agrees with a batch of one to 1e-5; as written here,
  // and by an override that says so, in every bit, which lockstep needs.
  virtual torch::Tensor SampleRows(const PolicyContext& context, const torch::Tensor& noise,
                                   const std::vector<const LoraWeights*>& lora) const {
    std::vector<torch::Tensor> rows;
    for (size_t i = 0; i < lora.size(); ++i) {
      const auto row = static_cast<int64_t>(i);
      rows.push_back(Sample(ContextRow(context, row), noise.narrow(0, row, 1), lora[i]));
    }
    return at::cat(rows, 0);
  }
  // As Sample for B = 1: a chunk that goes on from `running` (real-time chunking,
  // guided_sampler.h). `running` fits the policy (CheckRunningRows), which inpaints.
  virtual torch::Tensor Inpaint(const PolicyContext& /*context*/, const torch::Tensor& /*noise*/,
                                const LoraWeights* /*lora*/, const RunningRows& /*running*/) const {
    TORCH_CHECK(false, InpaintingError(spec().name).message());
  }
  // Whether every row of SampleRows has the bits of a batch of one, whatever stands beside it.
  // False: the server computes lockstep predictions in batches of one.
  virtual bool exact_rows() const { return true; }
  // Model-space chunk [K, d] -> environment actions [K, action_dim], and back for rows [n,
  // action_dim] -> [n, action_dim] with the training's transforms. `state` is PolicyContext::state
  // of the chunk's prediction: actions may be relative to it.
  virtual Eigen::MatrixXf ToEnvironment(const torch::Tensor& chunk,
                                        const torch::Tensor& state) const = 0;
  virtual torch::Tensor ToModel(const Eigen::MatrixXf& actions,
                                const torch::Tensor& state) const = 0;
};

// Loads a policy by name: "nano" (embedded weights) or a path to weights. `options` are KEY=VALUE
// of policies/openpi/policy_options.h, for a pi0 or pi0.5 checkpoint.
absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadFlowPolicy(
    const std::string& name_or_path, const std::vector<std::string>& options = {});

}  // namespace robostress
