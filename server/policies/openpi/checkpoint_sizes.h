#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/policies/openpi/checkpoint.h"

namespace robostress::openpi {

// All that says something about a network's sizes, beside `__metadata__.config`.
struct SizeSources {
  std::string path;                                    // for messages
  const std::map<std::string, StoredTensor>& tensors;  // by openpi's name
  const CheckpointConfig& declared;
  const CheckpointOptions& options;
};

// pi0 or pi0.5, by the norms of the action expert (plain or adaptive); where there are none, by
// config.json or pi0's state projection.
absl::StatusOr<bool> DetectPi05(const SizeSources& sources);

// Sizes of a checkpoint without `__metadata__.config`. What tensors show (vocabulary, action_dim,
// image) comes from the extent that most of them agree on, so that a misshaped tensor is found out
// and not believed; depth, heads and head_dim, which no tensor shows reliably, from the variants
// that config.json names or that the widths are those of: SigLIP So400m/14, gemma_2b, gemma_300m,
// dummy. Horizon comes from config.json or the options. The error names all that remains open.
// Adds to `notes` what was assumed.
absl::StatusOr<OpenpiConfig> DeriveSizes(const SizeSources& sources, bool pi05,
                                         std::vector<std::string>& notes);

// OK when config.json and the options agree with `config`; else every field that does not.
absl::Status CheckDeclared(const SizeSources& sources, const OpenpiConfig& config);

}  // namespace robostress::openpi
