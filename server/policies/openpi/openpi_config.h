#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "common/safetensors.h"

namespace robostress::openpi {

// Sizes of a pi0 or pi0.5 network. A weights file carries them as JSON under metadata key `config`,
// in the short names of kConfigFields (openpi_config.cc); files with inputs and expected values
// carry the same object.
struct OpenpiConfig {
  bool pi05 = false;          // adaptive RMSNorm and no state token
  int64_t image = 0;          // [pixels], square
  int64_t patch = 0;          // [pixels]
  int64_t vision_width = 0;   // SigLIP
  int64_t vision_depth = 0;   //
  int64_t vision_heads = 0;   //
  int64_t vision_mlp = 0;     //
  int64_t prefix_width = 0;   // Gemma over images and prompt
  int64_t prefix_mlp = 0;     //
  int64_t expert_width = 0;   // Gemma over state and actions
  int64_t expert_mlp = 0;     //
  int64_t depth = 0;          // layers of both experts
  int64_t heads = 0;          // query heads of both experts
  int64_t kv_heads = 0;       // key and value heads; divides heads
  int64_t head_dim = 0;       //
  int64_t vocab = 0;          // rows of the embedding table
  int64_t horizon = 0;        // K, actions per chunk
  int64_t action_dim = 0;     // d, padding included; the state is padded to it too
  int64_t prompt_tokens = 0;  // padded length of a prompt
  int64_t state_dim = 0;      // state entries before padding; 0: the file does not say

  int64_t patches() const { return (image / patch) * (image / patch); }
  int64_t suffix_tokens() const { return horizon + (pi05 ? 0 : 1); }
  const char* name() const { return pi05 ? "pi0.5" : "pi0"; }
};

// Reads and validates the sizes; an error names file, every missing or impossible field, its value
// and limits. The limits bound the work that a foreign file can cause before its tensors are seen.
absl::StatusOr<OpenpiConfig> ParseOpenpiConfig(const std::string& file, const std::string& json);
absl::StatusOr<OpenpiConfig> OpenpiConfigOf(const SafetensorsFile& file);

// The JSON that ParseOpenpiConfig reads.
std::string OpenpiConfigJson(const OpenpiConfig& config);

// The same limits for sizes that were derived otherwise; `where` begins the message.
absl::Status CheckOpenpiConfig(const std::string& where, const OpenpiConfig& config);

// OK when `other` (of file `other_file`) has the sizes of `config`; else every field that differs.
absl::Status CheckSameConfig(const std::string& file, const OpenpiConfig& config,
                             const std::string& other_file, const OpenpiConfig& other);

}  // namespace robostress::openpi
