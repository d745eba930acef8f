#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/lora.h"

namespace robostress {

// An adapter in the form of Hugging Face's PEFT: the two files of its folder.
struct PeftFiles {
  std::string safetensors;  // adapter_model.safetensors: base_model.model.MODULE.lora_{A,B}.weight
  std::string config_json;  // adapter_config.json
};
inline constexpr char kPeftTensors[] = "adapter_model.safetensors";
inline constexpr char kPeftConfig[] = "adapter_config.json";

// PEFT has one pair of matrices per module. An adapter per head is written as the equal one with
// heads x rank columns and zeros outside the heads' blocks (AsMatrices), under rank_pattern. The
// scale is 1: lora_alpha is the rank. A module is `root` + the target's name.
absl::StatusOr<PeftFiles> ToPeft(const std::vector<LoraTarget>& targets, const std::string& root,
                                 const LoraWeights& lora);

// The inverse, as `kind`. lora_alpha / r, or / sqrt(r) with use_rslora, is multiplied into B.
// `name` is for messages. Refuses, all problems at once: missing, unexpected and misshaped tensors;
// ranks that differ between modules; per head, a pair that is not zero outside the heads' blocks;
// what is not plain LoRA (DoRA, biases, whole modules, fan_in_fan_out, patterns that are regular
// expressions).
absl::StatusOr<LoraWeights> FromPeft(const std::string& name, const PeftFiles& files,
                                     const std::vector<LoraTarget>& targets,
                                     const std::string& root, LoraKind kind);

}  // namespace robostress
