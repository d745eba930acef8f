#pragma once

#include <torch/types.h>

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/policies/nano/nano_network.h"
#include "server/training/demonstrations.h"
#include "server/training/train_options.h"

namespace robostress {

// Losses of one step or of an evaluation.
struct TrainLosses {
  double flow = 0;  // weighted mean of (v - (eps - a))^2; with objective robust of the worst case
  double aux = 0;   // mean of squared normalised errors
  double clean_flow = 0;  // with objective robust: the flow loss of the demonstration itself
};

// What the held-out episodes say.
struct Evaluation {
  TrainLosses losses;
  double action_error =
      0;  // mean |error| of the first execute_steps sampled motion commands [command units]
  double gripper_agreement = 0;  // share of those steps whose gripper sign is right
  double target_error_mm = 0;    // auxiliary position of the target object
  double destination_error_mm = 0;
};

// Behaviour cloning by flow matching: minimises over the parameters
//   E_{t, eps} || v(s, t eps + (1 - t) a, t) - (eps - a) ||^2_w + aux_weight * || aux(s) - aux
//   ||^2,
// t = 0.999 Beta(1.5, 1) + 0.001 as in openpi, with AdamW and an exponential average of the
// weights. Objective robust puts the worst chunk near a in its place (worst_case_actions.h).
// Data-parallel on threads of one process: each has its own gradients over the shared parameters.
class Trainer {
 public:
  Trainer(TrainOptions options, NanoModel model, const Demonstrations& demonstrations);

  int64_t step() const { return step_; }
  int64_t parameter_count() const { return parameters_.size(0); }
  double learning_rate() const;
  double gradient_norm() const { return gradient_norm_; }
  // Spent on drawing frames and filling batches since construction, summed over threads [s].
  double data_seconds() const;

  // One optimizer step; frames, noise and augmentation depend on (seed, step) only.
  absl::StatusOr<TrainLosses> Step();
  bool has_held_out() const { return !demonstrations_.validation().empty(); }
  // With the averaged weights.
  absl::StatusOr<Evaluation> Evaluate() const;
  // The policy with the averaged weights.
  NanoModel Published() const;

  // Parameters, averages, both Adam moments and the step.
  absl::Status SaveCheckpoint(const std::string& path) const;
  absl::Status LoadCheckpoint(const std::string& path);

 private:
  // One thread's view of the parameters: leaves that share the values and own their gradients.
  struct Replica {
    torch::Tensor gradient;  // [parameters]
    std::vector<torch::Tensor> leaves;
    std::unique_ptr<NanoNetwork> network;
    std::unique_ptr<NanoNetwork> frozen;  // the same values, without gradients
    double data_seconds = 0;
  };
  StreamKey KeyOf(int64_t step, int thread) const;
  std::vector<int64_t> DrawFrames(RandomStream& random) const;
  absl::StatusOr<TrainLosses> Backward(int thread);
  std::vector<torch::Tensor> Slice(const torch::Tensor& flat) const;
  void Update();

  TrainOptions options_;
  NanoModel model_;  // its tensors are not used after construction
  const Demonstrations& demonstrations_;
  std::vector<NanoTensorInfo> table_;
  torch::Tensor parameters_, average_, moment1_, moment2_;  // [parameters]
  torch::Tensor decay_;                                     // [parameters] 1 where AdamW decays
  torch::Tensor step_weights_;                              // [K, 1], mean 1
  std::vector<Replica> replicas_;
  int64_t step_ = 0;
  double gradient_norm_ = 0;
};

// Trains as the options say: reads the data, writes OUT/config.yaml, train.jsonl (losses and
// samples/s), checkpoint.safetensors, nano.safetensors (averaged weights), DONE last. `resume` goes
// on from OUT's checkpoint.
absl::Status RunTraining(const TrainOptions& options, bool resume);

}  // namespace robostress
