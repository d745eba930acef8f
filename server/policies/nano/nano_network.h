#pragma once

#include <torch/types.h>

#include <string>
#include <utility>
#include <vector>

#include "adapter/velocity_field.h"
#include "server/policies/nano/nano_config.h"

namespace robostress {

// Bias of what may not be attended to; finite, so that a row with nothing to see stays a number (as
// in pi0).
inline constexpr float kMaskedBias = -2.3819763e38f;

// y = x / rms(x) * (1 + weight), or, where `dense` is defined, adaptive as in pi0.5: scale, shift,
// gate = split(dense cond + bias), y = x / rms(x) * (1 + scale) + shift, and `gate` multiplies the
// branch that follows.
struct NanoNorm {
  torch::Tensor weight;             // [w]
  torch::Tensor dense, dense_bias;  // [3 w, w], [3 w]
};

// One transformer layer, without biases (Gemma). w: model width, H heads of size h, m: GeGLU width.
struct NanoLayer {
  NanoNorm input_norm;
  torch::Tensor qkv_proj;  // [H h + 2 h, w]: rows q, k, v
  torch::Tensor o_proj;    // [w, H h]
  NanoNorm post_norm;
  torch::Tensor gate_up_proj;  // [2 m, w]: rows gate, up
  torch::Tensor down_proj;     // [w, m]
};

struct NanoCamera {
  std::vector<torch::Tensor> conv_weight;  // [out, in, k, k], stride 2; k = 5 first, then 3
  std::vector<torch::Tensor> conv_bias;    // [out]
  torch::Tensor token_weight, token_bias;  // [prefix_width, last conv], [prefix_width]
  torch::Tensor position;                  // [grid^2, prefix_width]
};

// q, k, v, o, gate, up, down of every expert layer, in this order.
std::vector<LoraTarget> NanoLoraTargets(const NanoConfig& config);

// All parameters of a nano policy.
struct NanoParameters {
  std::vector<NanoCamera> cameras;
  torch::Tensor words;                        // [vocabulary_rows, prefix_width]
  torch::Tensor readout;                      // [readout_tokens, prefix_width]
  torch::Tensor state_words, state_position;  // pi05: [state_bins, prefix_width], [state_dim, ..]
  std::vector<NanoLayer>
      prefix;  // layers; the last has only input_norm and k, v rows (nobody reads its output)
  torch::Tensor aux_norm;                  // [prefix_width]
  torch::Tensor aux_weight, aux_bias;      // [aux_dim, readout_tokens * prefix_width], [aux_dim]
  torch::Tensor state_weight, state_bias;  // pi0: state_proj
  torch::Tensor action_in_weight, action_in_bias;  // action_in_proj
  torch::Tensor time_in_weight,
      time_in_bias;  // pi0: action_time_mlp_in [We, 2 We], columns action, time; pi05: [We, We]
  torch::Tensor time_out_weight, time_out_bias;  // action_time_mlp_out or time_mlp_out
  std::vector<NanoLayer> expert;
  NanoNorm expert_norm;
  torch::Tensor action_out_weight, action_out_bias;  // action_out_proj
};

// A parameter's name in the weights file, its shape, and the standard deviation it starts with (0:
// zeros).
struct NanoTensorInfo {
  std::string name;
  std::vector<int64_t> shape;
  double init_std = 0;
  bool decays = false;  // by AdamW
};

// Every parameter, in a fixed order.
std::vector<NanoTensorInfo> NanoTensorTable(const NanoConfig& config);
// `tensors` in the order of the table.
NanoParameters AssembleNano(const NanoConfig& config, const std::vector<torch::Tensor>& tensors);
// Random tensors in the order of the table.
std::vector<torch::Tensor> RandomNanoTensors(const NanoConfig& config, uint64_t seed);

// emb(t) as in pi0: period_k = 4e-3 * (4.0 / 4e-3)^(k / (dim/2 - 1)), angle = 2 pi t / period in
// double; [B] -> [B, dim], all sines, then all cosines.
torch::Tensor TimeEmbedding(const torch::Tensor& t, int64_t dim);

// pi05: cond = silu(time_out(silu(time_in(emb(t))))) [B, expert_width].
torch::Tensor TimeCondition(const NanoParameters& parameters, const torch::Tensor& t);

// cos and sin of position * 10000^(-2 j / head_dim), [positions, head_dim / 2] each, for every
// position there is.
std::pair<torch::Tensor, torch::Tensor> RopeTables(const NanoConfig& config);

// The pi0 graph in small: images and words -> prefix transformer -> keys and values -> action
// expert. Functions of the parameters; differentiable wherever a parameter requires gradients.
class NanoNetwork {
 public:
  // What the prefix gives: the context and the auxiliary prediction [B, aux_dim], which is
  // undefined unless asked for.
  struct Prefix {
    PolicyContext context;
    torch::Tensor aux;
  };

  NanoNetwork(const NanoConfig& config, NanoParameters parameters);

  const NanoConfig& config() const { return config_; }
  const std::vector<LoraTarget>& lora_targets() const { return lora_targets_; }

  // images: per camera [B, 3, s, s] in [-1, 1], channels last in memory; words [B, max_words]
  // int64, 0 is padding; state [B, state_dim] normalised.
  Prefix EncodePrefix(const std::vector<torch::Tensor>& images, const torch::Tensor& words,
                      const torch::Tensor& state, bool with_aux) const;

  // v(s, x_u, u): x_u [B, K, d], u [B] -> [B, K, d]. The context may have fewer rows than x_u: row
  // i of the context then serves rows i n ... i n + n - 1.
  torch::Tensor Velocity(const PolicyContext& context, const torch::Tensor& x_u,
                         const torch::Tensor& u, const LoraWeights* lora) const;

 private:
  torch::Tensor EncodeImage(const NanoCamera& camera, const torch::Tensor& image) const;
  torch::Tensor EncodeStateWords(const torch::Tensor& state) const;
  // Suffix tokens [rows draws, T, e].
  torch::Tensor EmbedSuffix(const torch::Tensor& state, const torch::Tensor& x_u,
                            const torch::Tensor& u) const;

  NanoConfig config_;
  NanoParameters p_;
  std::vector<LoraTarget> lora_targets_;
  torch::Tensor rope_cos_, rope_sin_;  // [positions, head_dim / 2]
};

}  // namespace robostress
