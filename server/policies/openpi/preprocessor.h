#pragma once

#include <torch/types.h>

#include <Eigen/Core>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/types.h"
#include "server/policies/openpi/flow.h"
#include "server/policies/openpi/policy_setup.h"
#include "server/policies/openpi/tokenizer.h"

namespace robostress::openpi {

// From an observation to the network's inputs and from its chunk to the environment's actions, in
// openpi's order: state -> normalise -> prompt -> pad; un-normalise -> absolute -> cut. Immutable
// but for the tokenizer, which locks; any number of threads.
class Preprocessor {
 public:
  // Starts the tokenizer; it must not have more pieces than the embedding has rows.
  static absl::StatusOr<std::unique_ptr<const Preprocessor>> Create(PolicySetup setup,
                                                                    const OpenpiConfig& config);

  const PolicySetup& setup() const { return setup_; }
  const Tokenizer& tokenizer() const { return *tokenizer_; }

  // One row. Absent cameras are left out: they would only be masked, and positions skip what is
  // masked. The prompt keeps its padding, so that rows can be stacked.
  absl::StatusOr<ModelInputs> Prepare(const Observation& observation) const;

  // chunk [n, d], state [.., >= state_dim] normalised, as in ModelInputs -> [n, action_dim].
  Eigen::MatrixXf ToEnvironment(const torch::Tensor& chunk, const torch::Tensor& state) const;
  // The inverse, for actions [n, action_dim] -> [n, action_dim].
  torch::Tensor ToModel(const Eigen::MatrixXf& actions, const torch::Tensor& state) const;

 private:
  Preprocessor(PolicySetup setup, const OpenpiConfig& config, std::unique_ptr<Tokenizer> tokenizer)
      : setup_(std::move(setup)), config_(config), tokenizer_(std::move(tokenizer)) {}
  absl::StatusOr<torch::Tensor> PrepareView(const Observation& observation,
                                            const std::string& camera) const;
  // Normalised state [1, state_dim].
  absl::StatusOr<Eigen::MatrixXd> PrepareState(const Observation& observation) const;
  // The state in the environment's units.
  Eigen::VectorXd StateOf(const torch::Tensor& normalised) const;

  const PolicySetup setup_;
  const OpenpiConfig config_;
  const std::unique_ptr<Tokenizer> tokenizer_;
};

}  // namespace robostress::openpi
