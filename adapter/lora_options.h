#pragma once

#include "absl/status/status.h"
#include "adapter/method_way.h"

namespace robostress {

enum class LoraKind { kPerHead, kPerMatrix };

// Online LoRA updates, the method of the paper. The defaults are the paper's (sec:supp_method,
// sec:supp_lora) except learning_rate, which is nano's first; docs/results/learning-rates.md has
// those that were chosen on the dev split.
struct LoraOptions {
  static constexpr MethodWay kWay{.name = "online_adaptation", .key = "adapt"};

  bool adapt = false;
  LoraKind kind = LoraKind::kPerHead;  // how q and o are factored (docs/results/adapter-format.md)
  int rank = 4;
  double init_std = 0.01;
  double learning_rate = 1e-6;
  double beta1 = 0.9, beta2 = 0.999, adam_epsilon = 1e-8;
  double clip_norm = 1.0;
  double anchor_weight = 1e-4;  // lambda_anc; 0 in no_anchor
  int buffer_chunks = 32;
  int update_interval = 8;
  int batch = 4;
  bool use_residual = true;  // false: eta = 0 (no_residual)

  static LoraOptions At(double learning_rate) {
    return {.adapt = true, .learning_rate = learning_rate};
  }

  bool on() const { return adapt; }
  bool carries_over() const { return true; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Field("adapt", adapt, "update the LoRA online");
    v.Choice("lora", kind, {{"per_head", LoraKind::kPerHead}, {"per_matrix", LoraKind::kPerMatrix}},
             "per_head: a pair of factors for each attention head (openpi, the paper); "
             "per_matrix: one for each matrix (PEFT)");
    v.Field("rank", rank, "LoRA rank");
    v.Field("lora_init_std", init_std, "standard deviation of A at the start (B = 0)");
    v.Field("learning_rate", learning_rate, "Adam step size");
    v.Field("beta1", beta1, "Adam");
    v.Field("beta2", beta2, "Adam");
    v.Field("adam_epsilon", adam_epsilon, "Adam");
    v.Field("clip_norm", clip_norm, "global L2 norm of the gradient");
    v.Field("anchor_weight", anchor_weight, "lambda_anc of ||phi - phi_0||^2");
    v.Field("buffer_chunks", buffer_chunks, "FIFO length [chunks]");
    v.Field("update_interval", update_interval, "chunks between updates once the buffer is full");
    v.Field("batch", batch, "chunks per update, without replacement");
    v.Field("use_residual", use_residual, "false: the policy's own commands are the targets");
  }
};

}  // namespace robostress
