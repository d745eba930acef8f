#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/safetensors.h"
#include "server/policies/openpi/checkpoint_config.h"
#include "server/policies/openpi/norm_stats.h"
#include "server/policies/openpi/openpi_config.h"

namespace robostress::openpi {

// Who wrote the tensors' names.
enum class CheckpointLayout {
  kOpenpi,      // openpi's PyTorch model.safetensors; LeRobot's where `model.` was stripped
  kLerobot,     // the same names behind `model.`
  kLerobotOld,  // early 2025: model.paligemma_with_expert.paligemma.language_model.model.*
};
const char* LayoutName(CheckpointLayout layout);

// What no file of a checkpoint may say, stated by who opens it. A value that contradicts a file is
// an error.
struct CheckpointOptions {
  std::optional<int64_t> horizon;        // actions per chunk
  std::optional<int64_t> prompt_tokens;  // default: openpi's 48 (pi0) or 200 (pi0.5)
};

// A tensor of the network where it lies in a shard.
struct StoredTensor {
  std::shared_ptr<const SafetensorsFile> shard;
  std::string stored_name;  // as in the shard
  TensorView view;          // into the shard's mapping
};

// One place where statistics were found.
struct NormStatsSource {
  enum class Kind { kOpenpiJson, kLerobotNormalizer, kLerobotBuffers };
  Kind kind = Kind::kOpenpiJson;
  std::string file;
  std::string asset_id;  // openpi: the folder below assets/, e.g. physical-intelligence/libero
};

// An opened checkpoint: every shard mapped read-only and checked as a whole, no tensor copied or
// even touched. Immutable; copies share the mappings.
struct Checkpoint {
  std::string path;  // as given
  std::vector<std::shared_ptr<const SafetensorsFile>> shards;
  CheckpointLayout layout = CheckpointLayout::kOpenpi;
  OpenpiConfig config;        // sizes; config.pi05 says which of the two networks it is
  CheckpointConfig declared;  // config.json
  std::map<std::string, StoredTensor> tensors;  // by openpi's name; all that the network needs
  std::vector<std::string> unused;              // stored names that actions do not depend on
  std::vector<NormStatsSource> norm_stats;      // where found, first place that has any
  std::vector<std::string> notes;               // what was assumed and why, for people

  uint64_t file_bytes() const;           // of all shards
  uint64_t tensor_bytes() const;         // of `tensors`
  std::string stored_precision() const;  // "BF16", or "BF16 and F32"
};

// Opens a folder (model.safetensors or model.safetensors.index.json in it), a .safetensors file or
// an index. Tensor names decide between pi0 and pi0.5 and the layout; config.json and
// `__metadata__.config` must not contradict them. Sizes come from `__metadata__.config` where it is
// there, else from tensors, config.json and the known variants (checkpoint_sizes.h). Refused, with
// file, field, value and remedy, before memory is taken: what SafetensorsFile refuses, a wrong
// index, names stored twice, and a set of tensors that is not the network: all missing, unexpected,
// misshaped tensors and foreign dtypes in one message.
absl::StatusOr<Checkpoint> OpenCheckpoint(const std::string& path,
                                          const CheckpointOptions& options = {});

// The statistics of an opened checkpoint. `asset_id` chooses where there are several; the error
// lists them. Statistics longer than the network's action_dim are refused.
absl::StatusOr<NormStats> ReadNormStats(const Checkpoint& checkpoint,
                                        const std::string& asset_id = "");

}  // namespace robostress::openpi
