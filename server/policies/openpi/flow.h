#pragma once

#include <torch/types.h>

#include <vector>

#include "server/policies/openpi/gemma.h"
#include "server/policies/openpi/openpi_weights.h"

namespace robostress::openpi {

// What a network reads. The order of images is the order of their tokens.
struct ModelInputs {
  std::vector<torch::Tensor> images;       // per camera [B, 3, s, s] in [-1, 1]
  std::vector<torch::Tensor> image_masks;  // per camera [B] bool; false: absent, only masked out
  torch::Tensor tokens;                    // [B, n] int64
  torch::Tensor token_mask;                // [B, n] bool; false is padding
  torch::Tensor state;                     // [B, action_dim] normalised, zero-padded; pi0 only
};

// Embedded tokens of one expert. `starts` marks tokens that begin a block (masks.h).
struct Tokens {
  torch::Tensor embeddings;     // [B, T, w]
  torch::Tensor valid, starts;  // [B, T] bool
  torch::Tensor cond;           // [B, w] of the adaptive norms; pi0.5's suffix only
};

// Image features as prefix tokens: [B, 3, s, s] -> [B, patches, prefix_width], unscaled.
torch::Tensor EmbedImage(const OpenpiModel& model, const torch::Tensor& images);

// [image tokens per camera | prompt rows times sqrt(prefix_width)], one bidirectional block.
Tokens EmbedPrefix(const OpenpiModel& model, const ModelInputs& inputs);

// emb(t) [B, w]: period_k = 4e-3 (4 / 4e-3)^(k / (w/2 - 1)), angle = 2 pi t / period in float64, as
// openpi's PyTorch code; all sines, then all cosines; float32.
torch::Tensor EmbedTime(const torch::Tensor& t, int64_t width);

// pi0.5: cond = swish(time_out(swish(time_in(emb(t))))) [B, w].
torch::Tensor TimeCondition(const OpenpiModel& model, const torch::Tensor& t);

// pi0: [state token | action tokens], action token = time_out(swish(time_in([action_in(x),
// emb(t)]))); state and actions are a block each. pi0.5: action_in(x) and cond. x_t [B, K, d], t
// [B].
Tokens EmbedSuffix(const OpenpiModel& model, const torch::Tensor& state, const torch::Tensor& x_t,
                   const torch::Tensor& t);

// A prefix that ran once; denoising steps read it.
struct PrefixContext {
  KvCache cache;
  torch::Tensor valid;       // [B, P] bool
  torch::Tensor state;       // [B, action_dim]
  torch::Tensor out_normed;  // [B, P, prefix_width], no action depends on it
};
PrefixContext EncodePrefix(const OpenpiModel& model, const Tokens& prefix,
                           const torch::Tensor& state);

// Suffix after its final norm, [B, S, w]; its last K rows make the velocity.
torch::Tensor SuffixOnCache(const OpenpiModel& model, const PrefixContext& context,
                            const torch::Tensor& x_t, const torch::Tensor& t);
torch::Tensor SuffixJoint(const OpenpiModel& model, const Tokens& prefix,
                          const torch::Tensor& state, const torch::Tensor& x_t,
                          const torch::Tensor& t);

// v = action_out(last K rows) [B, K, d]; t = 1 is noise, t = 0 is data.
torch::Tensor Velocity(const OpenpiModel& model, const torch::Tensor& suffix_out);

// Euler from noise: dt = -1/steps, x += dt v(x, t), t += dt, both summed in float32 from t = 1
// while t >= -dt/2, as openpi does (1 - i/steps would give other actions).
struct EulerTrajectory {
  std::vector<float> times;       // at which v was taken
  std::vector<torch::Tensor> xs;  // [B, K, d] before each step, then the result
};
EulerTrajectory IntegrateEuler(const OpenpiModel& model, const PrefixContext& context,
                               const torch::Tensor& noise, int64_t steps);

// Flow matching (training): x_t = t noise + (1 - t) actions, u = noise - actions, loss = mean over
// all of (u - v)^2, padded action dimensions included. Joint pass; differentiable.
struct FlowLoss {
  torch::Tensor x_t, u_t, v_t, elements;  // [B, K, d]
  torch::Tensor mean;                     // []
};
FlowLoss ComputeFlowLoss(const OpenpiModel& model, const ModelInputs& inputs,
                         const torch::Tensor& actions, const torch::Tensor& noise,
                         const torch::Tensor& t);

}  // namespace robostress::openpi
