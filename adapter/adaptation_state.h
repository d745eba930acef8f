#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/lora_adapter.h"
#include "adapter/nominal_arm.h"

namespace robostress {

// Everything that online adaptation remembers, as a safetensors file; its tensors are listed in
// docs/results/adapter-format.md.
// An adapter restored from it continues bit for bit.
struct AdaptationState {
  std::string policy;                       // PolicySpec::name
  std::string model_hash;                   // SHA-256 of the weights it belongs to
  std::string method;                       // MethodOptions::method
  LoraKind lora_kind = LoraKind::kPerHead;  // LoraOptions::kind
  std::string session;                      // identity that keyed phi_0, for people
  LoraState lora;
  uint64_t triggers = 0;           // updates triggered, keys the next update's draws
  uint64_t feedback_sequence = 0;  // last chunk taken
  int64_t chunks_since_clear = 0;
  int64_t task = -1;                                // of the last episode started, -1: none
  int64_t nominal_task = -1, nominal_episode = -1;  // whose motion `nominal` is
  NominalArm::State nominal;
  double last_loss = 0;
  std::vector<std::shared_ptr<const TrainingChunk>> buffer;  // oldest first
};

absl::StatusOr<std::string> SerializeAdaptationState(const AdaptationState& state,
                                                     const std::vector<LoraTarget>& targets);

// Trusts nothing: format, model hash, names, shapes and types are checked against the policy.
// `name` is for messages.
absl::StatusOr<AdaptationState> ParseAdaptationState(const std::string& name, std::string bytes,
                                                     const VelocityField& field,
                                                     const std::string& model_hash);

// All but the buffer, for programs that have the policy's layers and not its network. An empty
// `model_hash` is not compared.
absl::StatusOr<AdaptationState> ParseAdapter(const std::string& name, std::string bytes,
                                             const std::vector<LoraTarget>& targets,
                                             const std::string& model_hash);

}  // namespace robostress
