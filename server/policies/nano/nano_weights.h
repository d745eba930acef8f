#pragma once

#include <torch/types.h>

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/policies/nano/nano_config.h"
#include "server/policies/vocabulary.h"

namespace robostress {

// z-score per dimension: x = (value - mean) / (std + 1e-6), as in openpi.
struct ZScore {
  std::vector<float> mean, std;
};

// Everything a nano policy is: shape, words, normalisation, parameters in the order of
// NanoTensorTable.
struct NanoModel {
  NanoConfig config;
  Vocabulary vocabulary;
  ZScore state;    // [state_dim]
  ZScore actions;  // [action_dim]
  ZScore aux;      // [aux_dim]
  std::vector<torch::Tensor> tensors;
};

// The weights file: safetensors; metadata format = "robostress-nano", format_version, config
// (YAML), vocabulary (words separated by spaces); float32 tensors of the table and
// normalize.{state,actions,aux}.{mean,std}.
inline constexpr char kNanoFormat[] = "robostress-nano";
inline constexpr char kNanoFormatVersion[] = "1";

absl::Status SaveNanoModel(const NanoModel& model, const std::string& path);
// Reports every missing, surplus, misshapen or non-finite tensor at once.
absl::StatusOr<NanoModel> LoadNanoModel(const std::string& path);
// Random parameters, identity normalisation, no words: for tests and timing.
NanoModel RandomNanoModel(const NanoConfig& config, uint64_t seed);

}  // namespace robostress
