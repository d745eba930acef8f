#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::openpi {

// What a checkpoint's config.json says of the network, as openpi's converter or LeRobot wrote it.
// Nothing is required; keys that are not listed here are left alone.
struct CheckpointConfig {
  enum class Writer { kNone, kOpenpi, kLerobot };  // kLerobot: it has a `type`
  std::string file;                                // empty where there is no config.json
  Writer writer = Writer::kNone;

  std::optional<bool> pi05;              // LeRobot's type; openpi has no such field
  std::string paligemma_variant;         // gemma_2b, ...; empty: not said
  std::string action_expert_variant;     // gemma_300m, ...
  std::string precision;                 // bfloat16 or float32, of training
  std::optional<int64_t> action_dim;     // padded: action_dim, max_action_dim
  std::optional<int64_t> state_dim;      // padded: max_state_dim
  std::optional<int64_t> horizon;        // action_horizon, chunk_size
  std::optional<int64_t> prompt_tokens;  // tokenizer_max_length
  std::optional<int64_t> image;          // image_resolution, resize_imgs_with_padding [pixels]
  std::optional<int64_t> euler_steps;    // num_inference_steps, num_steps

  // LeRobot's features: cameras by name, entries before padding.
  std::vector<std::string> cameras;  // e.g. observation.images.base_0_rgb
  std::optional<int64_t> robot_state_dim, robot_action_dim;
  std::map<std::string, std::string> normalization;  // STATE, ACTION -> MEAN_STD, QUANTILES, ...
};

// The error lists every field of a wrong type or range with its value and the limit, and refuses
// `type`s that are neither pi0 nor pi05.
absl::StatusOr<CheckpointConfig> ParseCheckpointConfig(const std::string& file,
                                                       const std::string& json);

}  // namespace robostress::openpi
