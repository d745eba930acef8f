#pragma once

#include <torch/types.h>

#include <cstdint>
#include <string>
#include <vector>

#include "server/policies/openpi/gemma.h"
#include "server/policies/openpi/linear.h"
#include "server/policies/openpi/openpi_config.h"
#include "server/policies/openpi/siglip.h"

namespace robostress::openpi {

// Every tensor that a pi0 or pi0.5 network computes with, float32 or bfloat16 (a layer computes in
// the type of its weight). Copies share storage.
struct OpenpiWeights {
  Siglip vision;
  Linear projector;         // [vision_width -> prefix_width]
  torch::Tensor embedding;  // [vocab, prefix_width]
  GemmaStack prefix, expert;
  Linear action_in;   // [action_dim -> expert_width]
  Linear action_out;  // [expert_width -> action_dim]
  Linear state;       // [action_dim -> expert_width], pi0
  Linear time_in;     // pi0: action_time_mlp_in [2 w -> w], columns action, time; pi0.5: [w -> w]
  Linear time_out;    // action_time_mlp_out or time_mlp_out [w -> w]
};

// A network: immutable once made, so any number of threads may compute with it.
struct OpenpiModel {
  OpenpiConfig config;
  OpenpiWeights weights;
};

// Meets every parameter under openpi's name, with the shape that the configuration asks for.
class ParameterVisitor {
 public:
  virtual ~ParameterVisitor() = default;
  virtual void OnTensor(const std::string& name, const std::vector<int64_t>& shape,
                        torch::Tensor& tensor) = 0;
  // `name` without ".weight". By default meets weight [out, in] and, where there is one, bias
  // [out].
  virtual void OnLinear(const std::string& name, int64_t in, int64_t out, bool bias,
                        Linear& linear);
};

// The one list of names: loading (checkpoint_load.h), gradients, LoRA and random weights all go
// through it.
void VisitParameters(const OpenpiConfig& config, OpenpiWeights& weights, ParameterVisitor& visitor);

// N(0, 1/in) matrices, small biases and norms: outputs of order one. For tests and timing.
OpenpiModel RandomOpenpiModel(const OpenpiConfig& config, uint64_t seed);

// Names of tensors that files hold and actions do not depend on.
extern const char kEmbeddingName[];   // ...language_model.embed_tokens.weight
extern const char kTiedHeadName[];    // the same table as PaliGemma's lm_head
extern const char kUnusedHeadName[];  // the action expert's lm_head, never used

}  // namespace robostress::openpi
