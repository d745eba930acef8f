#include "server/policies/openpi/flow.h"

#include <torch/types.h>

#include <cmath>

#include "server/policies/openpi/masks.h"

namespace robostress::openpi {
namespace {

constexpr double kMinPeriod = 4e-3, kMaxPeriod = 4.0;

AttentionShape ShapeOf(const OpenpiConfig& c) { return {c.heads, c.kv_heads, c.head_dim}; }

torch::Tensor Bools(int64_t batch, int64_t tokens, bool value, const torch::Tensor& like) {
  return at::full({batch, tokens}, value, like.options().dtype(torch::kBool));
}

// Marks the first action, and the state token before it where there is one.
torch::Tensor SuffixStarts(const OpenpiConfig& c, int64_t batch, const torch::Tensor& like) {
  torch::Tensor starts = Bools(batch, c.suffix_tokens(), false, like);
  starts.narrow(1, 0, c.suffix_tokens() - c.horizon + 1).fill_(true);
  return starts;
}

}  // namespace

torch::Tensor EmbedImage(const OpenpiModel& model, const torch::Tensor& images) {
  const SiglipPass pass = RunSiglip(model.weights.vision, model.config.vision_heads, images);
  return Apply(model.weights.projector, pass.features);
}

Tokens EmbedPrefix(const OpenpiModel& model, const ModelInputs& inputs) {
  const int64_t batch = inputs.tokens.size(0), patches = model.config.patches();
  std::vector<torch::Tensor> embeddings, valid;
  for (size_t i = 0; i < inputs.images.size(); ++i) {
    embeddings.push_back(EmbedImage(model, inputs.images[i]));  // [B, patches, w]
    valid.push_back(inputs.image_masks[i].unsqueeze(1).expand({batch, patches}));
  }
  const double scale = std::sqrt(static_cast<double>(model.config.prefix_width));
  embeddings.push_back(at::embedding(model.weights.embedding, inputs.tokens) * scale);
  valid.push_back(inputs.token_mask);
  Tokens prefix;
  prefix.embeddings = at::cat(embeddings, 1);
  prefix.valid = at::cat(valid, 1);
  prefix.starts = at::zeros_like(prefix.valid);
  return prefix;
}

torch::Tensor EmbedTime(const torch::Tensor& t, int64_t width) {
  const torch::Tensor fraction = at::linspace(0, 1, width / 2, t.options().dtype(torch::kFloat64));
  const torch::Tensor period = kMinPeriod * at::pow(kMaxPeriod / kMinPeriod, fraction);
  const torch::Tensor angle =
      t.to(torch::kFloat64).unsqueeze(1) * (2 * M_PI / period).unsqueeze(0);  // [B, w / 2]
  return at::cat({angle.sin(), angle.cos()}, 1).to(torch::kFloat32);
}

torch::Tensor TimeCondition(const OpenpiModel& model, const torch::Tensor& t) {
  const OpenpiWeights& w = model.weights;
  const torch::Tensor embedded = EmbedTime(t, model.config.expert_width);
  return at::silu(Apply(w.time_out, at::silu(Apply(w.time_in, embedded))));
}

Tokens EmbedSuffix(const OpenpiModel& model, const torch::Tensor& state, const torch::Tensor& x_t,
                   const torch::Tensor& t) {
  const OpenpiConfig& c = model.config;
  const OpenpiWeights& w = model.weights;
  const int64_t batch = x_t.size(0);
  Tokens suffix;
  const torch::Tensor actions = Apply(w.action_in, x_t);  // [B, K, w]
  if (c.pi05) {
    suffix.embeddings = actions;
    suffix.cond = TimeCondition(model, t);
  } else {
    const torch::Tensor time =
        EmbedTime(t, c.expert_width).unsqueeze(1).expand({batch, c.horizon, c.expert_width});
    const torch::Tensor mixed =
        Apply(w.time_out, at::silu(Apply(w.time_in, at::cat({actions, time}, 2))));
    suffix.embeddings = at::cat({Apply(w.state, state).unsqueeze(1), mixed}, 1);
  }
  suffix.valid = Bools(batch, c.suffix_tokens(), true, x_t);
  suffix.starts = SuffixStarts(c, batch, x_t);
  return suffix;
}

PrefixContext EncodePrefix(const OpenpiModel& model, const Tokens& prefix,
                           const torch::Tensor& state) {
  PrefixPass pass = RunPrefix(model.weights.prefix, ShapeOf(model.config), prefix.embeddings,
                              BlockMask(prefix.valid, prefix.starts), Positions(prefix.valid));
  return {std::move(pass.cache), prefix.valid, state, std::move(pass.out_normed)};
}

torch::Tensor SuffixOnCache(const OpenpiModel& model, const PrefixContext& context,
                            const torch::Tensor& x_t, const torch::Tensor& t) {
  const Tokens suffix = EmbedSuffix(model, context.state, x_t, t);
  return RunSuffix(model.weights.expert, ShapeOf(model.config), suffix.embeddings, suffix.cond,
                   SuffixMask(context.valid, suffix.valid, suffix.starts),
                   SuffixPositions(context.valid, suffix.valid), context.cache);
}

torch::Tensor SuffixJoint(const OpenpiModel& model, const Tokens& prefix,
                          const torch::Tensor& state, const torch::Tensor& x_t,
                          const torch::Tensor& t) {
  const Tokens suffix = EmbedSuffix(model, state, x_t, t);
  const torch::Tensor valid = at::cat({prefix.valid, suffix.valid}, 1);
  const torch::Tensor starts = at::cat({prefix.starts, suffix.starts}, 1);
  return RunJoint(model.weights.prefix, model.weights.expert, ShapeOf(model.config),
                  prefix.embeddings, suffix.embeddings, suffix.cond, BlockMask(valid, starts),
                  Positions(valid));
}

torch::Tensor Velocity(const OpenpiModel& model, const torch::Tensor& suffix_out) {
  const int64_t horizon = model.config.horizon;
  const torch::Tensor actions = suffix_out.narrow(1, suffix_out.size(1) - horizon, horizon);
  return Apply(model.weights.action_out, actions.to(torch::kFloat32));
}

EulerTrajectory IntegrateEuler(const OpenpiModel& model, const PrefixContext& context,
                               const torch::Tensor& noise, int64_t steps) {
  EulerTrajectory trajectory;
  trajectory.xs.push_back(noise);
  const float dt = static_cast<float>(-1.0 / static_cast<double>(steps));
  for (float time = 1.0f; time >= -dt / 2; time += dt) {
    const torch::Tensor& x = trajectory.xs.back();
    const torch::Tensor t = at::full({x.size(0)}, time, x.options());
    const torch::Tensor v = Velocity(model, SuffixOnCache(model, context, x, t));
    trajectory.times.push_back(time);
    trajectory.xs.push_back(x + dt * v);
  }
  return trajectory;
}

FlowLoss ComputeFlowLoss(const OpenpiModel& model, const ModelInputs& inputs,
                         const torch::Tensor& actions, const torch::Tensor& noise,
                         const torch::Tensor& t) {
  FlowLoss loss;
  const torch::Tensor time = t.view({-1, 1, 1});
  loss.x_t = time * noise + (1 - time) * actions;
  loss.u_t = noise - actions;
  const torch::Tensor out =
      SuffixJoint(model, EmbedPrefix(model, inputs), inputs.state, loss.x_t, t);
  loss.v_t = Velocity(model, out);
  loss.elements = (loss.u_t - loss.v_t).square();
  loss.mean = loss.elements.mean();
  return loss;
}

}  // namespace robostress::openpi
