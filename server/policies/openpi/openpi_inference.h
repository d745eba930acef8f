#pragma once

#include <torch/types.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/velocity_field.h"
#include "server/policies/openpi/euler_steps.h"
#include "server/policies/openpi/flow.h"
#include "server/policies/openpi/precision.h"

namespace robostress::openpi {

struct InferenceOptions {
  Precision precision = Precision::kFloat32;  // of the large matrices and of stored keys, values
  std::string device = "cpu";                 // or "cuda", "cuda:1", ...
  int64_t steps = 10;                         // of Euler
  // With bf16 matrices: what flows between them. Automatic is bfloat16 where the device multiplies
  // it and float32, under widened weights, elsewhere.
  enum class Activations { kAutomatic, kFloat32, kBf16 } activations = Activations::kAutomatic;
};

// Predictions of pi0 and pi0.5, fast: the same actions as EncodePrefix and IntegrateEuler of flow.h
// (the reference), to rounding. The prefix runs once, over valid tokens only; ten steps read its
// keys and values. Immutable; any number of threads may predict.
class OpenpiInference {
 public:
  // The model's tensors are shared where dtype and device are kept. A device that is not there is
  // FailedPrecondition.
  static absl::StatusOr<std::unique_ptr<OpenpiInference>> Create(OpenpiModel model,
                                                                 const InferenceOptions& options);
  ~OpenpiInference();

  const OpenpiConfig& config() const { return setup_.config; }
  // ExpertLoraTargets of the network.
  const std::vector<LoraTarget>& lora_targets() const { return lora_targets_; }

  // Inputs of B rows, on the CPU. A row's valid tokens are counted per row: rows may differ.
  absl::StatusOr<PolicyContext> Encode(const ModelInputs& inputs) const;

  // noise [B, K, d] and the context of B rows -> model-space actions [B, K, d] float32, on the CPU.
  // lora may be null. The context is only read.
  absl::StatusOr<torch::Tensor> Sample(const PolicyContext& context, const torch::Tensor& noise,
                                       const LoraWeights* lora) const;

  // As Sample, each row with its own adapter (null: none) in one pass; row i agrees with a batch of
  // one to 1e-5.
  absl::StatusOr<torch::Tensor> SampleRows(const PolicyContext& context, const torch::Tensor& noise,
                                           const std::vector<const LoraWeights*>& lora) const;

 private:
  struct Graphs;  // recorded steps by shape

  OpenpiInference(OpenpiModel model, const InferenceOptions& options, const torch::Device& device);
  // Checked inputs -> actions.
  torch::Tensor Predict(const PolicyContext& context, const torch::Tensor& noise,
                        const Adapters& adapters) const;
  torch::Tensor PredictByGraph(const PolicyContext& context, const torch::Tensor& noise,
                               const Adapters& adapters) const;

  InferenceSetup setup_;
  InferenceWeights weights_;
  int64_t steps_;
  std::vector<LoraTarget> lora_targets_;
  std::unique_ptr<Graphs> graphs_;  // null on the CPU
};

}  // namespace robostress::openpi
