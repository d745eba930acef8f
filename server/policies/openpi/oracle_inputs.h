#pragma once

#include <torch/types.h>

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/safetensors.h"
#include "server/policies/openpi/flow.h"

namespace robostress::openpi {

// The tensors under `inputs/` of a file with expected values.
struct OracleInputs {
  std::vector<std::string> cameras;  // of model.images
  ModelInputs model;
  torch::Tensor noise;  // [B, K, d], where sampling starts
  // inputs/loss.*; undefined where the file has none of them.
  torch::Tensor loss_actions, loss_noise;  // [B, K, d]
  torch::Tensor loss_time;                 // [B]
};

// Reads and checks every input against `config`: batch, sizes, dtypes, token ids, finite values,
// and that the attention over all of it stays below 1 GiB. The error lists all problems.
// Cameras come in openpi's order (base_0_rgb, left_wrist_0_rgb, right_wrist_0_rgb), others behind
// them by name.
absl::StatusOr<OracleInputs> LoadOracleInputs(const SafetensorsFile& file,
                                              const OpenpiConfig& config);

}  // namespace robostress::openpi
