#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "adapter/lora.h"

namespace robostress {

// Where a target's weight lies in a weights file: rows first_row ... of `tensor`.
struct WeightRows {
  std::string tensor;
  int64_t first_row = 0;
};

// A weights file as what adapters sit on: nano's, or one with openpi's tensor names.
struct AdapterBase {
  std::string path;
  std::string model_hash;           // SHA-256 of the file
  std::vector<LoraTarget> targets;  // in the order of LoraWeights
  std::vector<WeightRows> weights;  // of each target
  std::string module_root;          // before a target's name in PEFT's modules
};
absl::StatusOr<AdapterBase> OpenAdapterBase(const std::string& path);

// Writes `base` with W + B A in place of each target's W, in the file's own types; everything else
// keeps its bytes. Holds one copy of the file in memory.
absl::Status WriteMerged(const AdapterBase& base, const LoraWeights& lora, const std::string& path);

}  // namespace robostress
