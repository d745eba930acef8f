#include "server/policies/nano/nano_network.h"

#include <torch/types.h>

#include <cmath>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "adapter/lora.h"
#include "common/check.h"
#include "server/policies/nano/fused_ops.h"

namespace robostress {
namespace {

using torch::Tensor;

constexpr double kRopeBase = 10000.0;
constexpr int kTargetsPerLayer = 7;  // q, k, v, o, gate, up, down

// The one list of parameters: calls f(name, shape, init_std, decays, tensor) in the order of the
// file.
template <class F>
void VisitParameters(const NanoConfig& c, NanoParameters& p, F&& f) {
  const auto fan = [](int64_t inputs) { return 1.0 / std::sqrt(static_cast<double>(inputs)); };
  const int64_t w = c.prefix_width, e = c.expert_width, hq = c.heads * c.head_dim, h = c.head_dim;
  const double residual = 1.0 / std::sqrt(2.0 * c.layers);

  p.cameras.resize(c.cameras.size());
  for (size_t v = 0; v < c.cameras.size(); ++v) {
    NanoCamera& camera = p.cameras[v];
    const std::string name = absl::StrCat("cameras.", v, ".");
    camera.conv_weight.resize(c.conv_channels.size());
    camera.conv_bias.resize(c.conv_channels.size());
    int64_t in = 3;
    for (size_t i = 0; i < c.conv_channels.size(); ++i) {
      const int64_t out = c.conv_channels[i], k = i == 0 ? 5 : 3;
      f(absl::StrCat(name, "conv.", i, ".weight"), {out, in, k, k},
        std::sqrt(2.0) * fan(in * k * k), true, camera.conv_weight[i]);
      f(absl::StrCat(name, "conv.", i, ".bias"), {out}, 0.0, false, camera.conv_bias[i]);
      in = out;
    }
    f(name + "token.weight", {w, in}, fan(in), true, camera.token_weight);
    f(name + "token.bias", {w}, 0.0, false, camera.token_bias);
    f(name + "position", {c.image_tokens(), w}, 0.5, false, camera.position);
  }
  f("prefix.words", {c.vocabulary_rows, w}, fan(w), false, p.words);
  f("prefix.readout", {c.readout_tokens, w}, 1.0, false, p.readout);
  if (c.pi05()) {
    f("prefix.state_words", {c.state_bins, w}, 1.0, false, p.state_words);
    f("prefix.state_position", {c.state_dim, w}, 1.0, false, p.state_position);
  }

  const auto norm = [&](const std::string& name, int64_t width, bool adaptive, NanoNorm& n) {
    if (!adaptive) return f(name + ".weight", {width}, 0.0, false, n.weight);
    f(name + ".dense.weight", {3 * width, width}, 0.0, true, n.dense);
    f(name + ".dense.bias", {3 * width}, 0.0, false, n.dense_bias);
  };
  const auto layer = [&](const std::string& name, int64_t width, int64_t mlp, bool adaptive,
                         bool only_keys, NanoLayer& l) {
    norm(name + "input_norm", width, adaptive, l.input_norm);
    f(name + (only_keys ? "kv_proj.weight" : "qkv_proj.weight"),
      {(only_keys ? 0 : hq) + 2 * h, width}, fan(width), true, l.qkv_proj);
    if (only_keys) return;
    f(name + "o_proj.weight", {width, hq}, residual * fan(hq), true, l.o_proj);
    norm(name + "post_norm", width, adaptive, l.post_norm);
    f(name + "gate_up_proj.weight", {2 * mlp, width}, fan(width), true, l.gate_up_proj);
    f(name + "down_proj.weight", {width, mlp}, residual * fan(mlp), true, l.down_proj);
  };
  p.prefix.resize(c.layers);
  for (int i = 0; i < c.layers; ++i) {
    layer(absl::StrCat("prefix.layers.", i, "."), w, c.prefix_mlp, false, i + 1 == c.layers,
          p.prefix[i]);
  }
  const int64_t readout = c.readout_tokens * w;
  f("aux.norm.weight", {w}, 0.0, false, p.aux_norm);
  f("aux.weight", {c.aux_dim, readout}, fan(readout), true, p.aux_weight);
  f("aux.bias", {c.aux_dim}, 0.0, false, p.aux_bias);

  const int64_t token = static_cast<int64_t>(c.steps_per_token) * c.model_action_dim;
  if (!c.pi05()) {
    f("state_proj.weight", {e, c.state_dim}, fan(c.state_dim), true, p.state_weight);
    f("state_proj.bias", {e}, 0.0, false, p.state_bias);
  }
  f("action_in_proj.weight", {e, token}, fan(token), true, p.action_in_weight);
  f("action_in_proj.bias", {e}, 0.0, false, p.action_in_bias);
  const std::string time = c.pi05() ? "time_mlp" : "action_time_mlp";
  const int64_t time_in = c.pi05() ? e : 2 * e;
  f(time + "_in.weight", {e, time_in}, fan(time_in), true, p.time_in_weight);
  f(time + "_in.bias", {e}, 0.0, false, p.time_in_bias);
  f(time + "_out.weight", {e, e}, fan(e), true, p.time_out_weight);
  f(time + "_out.bias", {e}, 0.0, false, p.time_out_bias);
  p.expert.resize(c.layers);
  for (int i = 0; i < c.layers; ++i) {
    layer(absl::StrCat("expert.layers.", i, "."), e, c.expert_mlp, c.pi05(), false, p.expert[i]);
  }
  norm("expert.norm", e, c.pi05(), p.expert_norm);
  f("action_out_proj.weight", {token, e}, fan(e), true, p.action_out_weight);
  f("action_out_proj.bias", {token}, 0.0, false, p.action_out_bias);
}

// y = x W^T, where the rows of W belong to one or more projections, each with its LoRA if there is
// one, which adds to its part of y.
Tensor Project(const Tensor& x, const Tensor& weight, const LoraWeights* lora, size_t first_target,
               size_t num_targets) {
  const Tensor y = torch::linear(x, weight);
  if (lora == nullptr) return y;
  std::vector<Tensor> deltas;
  for (size_t i = first_target; i < first_target + num_targets; ++i) {
    deltas.push_back(LoraDelta(x, lora->A[i], lora->B[i]));
  }
  return y + (deltas.size() == 1 ? deltas[0] : torch::cat(deltas, -1));
}

// What a norm gives: x + delta, its normalised form, and the gate [B, 1, w] of the branch that
// follows, undefined for a plain norm.
struct Normed {
  Tensor x, y, gate;
};

Normed AddNorm(const Tensor& x, const Tensor& delta, const NanoNorm& norm, const Tensor& cond) {
  if (!norm.dense.defined()) {
    auto [sum, y] = AddRmsNorm(x, delta, norm.weight);
    return {sum, y, {}};
  }
  const auto modulation =
      torch::linear(cond, norm.dense, norm.dense_bias).unsqueeze(1).chunk(3, -1);
  auto [sum, unit] = AddRmsNorm(x, delta, torch::zeros({x.size(-1)}));
  return {sum, unit * (1 + modulation[0]) + modulation[1], modulation[2]};
}

Tensor Gated(const Tensor& branch, const Tensor& gate) {
  return gate.defined() ? gate * branch : branch;
}

}  // namespace

std::vector<NanoTensorInfo> NanoTensorTable(const NanoConfig& config) {
  std::vector<NanoTensorInfo> table;
  NanoParameters unused;
  VisitParameters(config, unused,
                  [&](const std::string& name, std::vector<int64_t> shape, double init_std,
                      bool decays, Tensor&) {
                    table.push_back({name, std::move(shape), init_std, decays});
                  });
  return table;
}

NanoParameters AssembleNano(const NanoConfig& config, const std::vector<Tensor>& tensors) {
  NanoParameters parameters;
  size_t next = 0;
  VisitParameters(
      config, parameters,
      [&](const std::string&, const std::vector<int64_t>& shape, double, bool, Tensor& tensor) {
        RS_CHECK(next < tensors.size() && tensors[next].sizes() == torch::IntArrayRef(shape));
        tensor = tensors[next++];
      });
  return parameters;
}

std::vector<Tensor> RandomNanoTensors(const NanoConfig& config, uint64_t seed) {
  torch::NoGradGuard no_grad;
  auto generator = at::make_generator<at::CPUGeneratorImpl>(seed);
  std::vector<Tensor> tensors;
  for (const NanoTensorInfo& info : NanoTensorTable(config)) {
    tensors.push_back(info.init_std == 0 ? torch::zeros(info.shape)
                                         : torch::randn(info.shape, generator) * info.init_std);
  }
  return tensors;
}

Tensor TimeEmbedding(const Tensor& t, int64_t dim) {
  constexpr double kMinPeriod = 4e-3, kMaxPeriod = 4.0;
  const Tensor fraction = torch::linspace(0.0, 1.0, dim / 2, torch::kFloat64);
  const Tensor period = kMinPeriod * torch::pow(kMaxPeriod / kMinPeriod, fraction);
  const Tensor angle = 2.0 * std::numbers::pi * t.to(torch::kFloat64).unsqueeze(-1) / period;
  return torch::cat({angle.sin(), angle.cos()}, -1).to(torch::kFloat32);
}

Tensor TimeCondition(const NanoParameters& p, const Tensor& t) {
  const Tensor embedded = TimeEmbedding(t, p.time_in_weight.size(1));
  const Tensor hidden = torch::silu(torch::linear(embedded, p.time_in_weight, p.time_in_bias));
  return torch::silu(torch::linear(hidden, p.time_out_weight, p.time_out_bias));
}

std::pair<Tensor, Tensor> RopeTables(const NanoConfig& config) {
  torch::NoGradGuard no_grad;
  const int64_t positions = config.prefix_tokens() + config.suffix_tokens(), h = config.head_dim;
  const Tensor frequency =
      torch::pow(kRopeBase, torch::arange(h / 2, torch::kFloat64) * (-2.0 / h));
  const Tensor angle = torch::arange(positions, torch::kFloat64).unsqueeze(1) * frequency;
  return {angle.cos().to(torch::kFloat32), angle.sin().to(torch::kFloat32)};
}

std::vector<LoraTarget> NanoLoraTargets(const NanoConfig& config) {
  const int64_t e = config.expert_width, m = config.expert_mlp, hq = config.heads * config.head_dim,
                h = config.head_dim;
  std::vector<LoraTarget> targets;
  for (int i = 0; i < config.layers; ++i) {
    const std::string name = absl::StrCat("layers.", i, ".");
    targets.push_back({name + "q_proj", e, hq, config.heads});
    targets.push_back({name + "k_proj", e, h});
    targets.push_back({name + "v_proj", e, h});
    targets.push_back({name + "o_proj", hq, e, 1, config.heads});
    targets.push_back({name + "gate_proj", e, m});
    targets.push_back({name + "up_proj", e, m});
    targets.push_back({name + "down_proj", m, e});
  }
  return targets;
}

NanoNetwork::NanoNetwork(const NanoConfig& config, NanoParameters parameters)
    : config_(config), p_(std::move(parameters)), lora_targets_(NanoLoraTargets(config)) {
  std::tie(rope_cos_, rope_sin_) = RopeTables(config);
}

Tensor NanoNetwork::EncodeImage(const NanoCamera& camera, const Tensor& image) const {
  Tensor x = image;  // [B, 3, s, s]
  for (size_t i = 0; i < camera.conv_weight.size(); ++i) {
    const int64_t k = camera.conv_weight[i].size(-1);
    x = torch::relu(torch::conv2d(x, camera.conv_weight[i], camera.conv_bias[i], 2, (k - 1) / 2));
  }
  x = x.permute({0, 2, 3, 1})
          .reshape({x.size(0), config_.image_tokens(), x.size(1)});  // [B, grid^2, c]
  return torch::linear(x, camera.token_weight, camera.token_bias) + camera.position;
}

// Each entry as one of `state_bins` words, as pi0.5's prompt has it, and the word's place. Entries
// beyond the span have the outermost words.
Tensor NanoNetwork::EncodeStateWords(const Tensor& state) const {
  const double bins = config_.state_bins;
  const Tensor bin = ((state / config_.state_span + 1) * (bins / 2)).floor().clamp(0, bins - 1);
  return torch::embedding(p_.state_words, bin.to(torch::kInt64)) + p_.state_position;
}

NanoNetwork::Prefix NanoNetwork::EncodePrefix(const std::vector<Tensor>& images,
                                              const Tensor& words, const Tensor& state,
                                              bool with_aux) const {
  const int64_t batch = words.size(0), heads = config_.heads, h = config_.head_dim;
  std::vector<Tensor> tokens = {p_.readout.unsqueeze(0).expand({batch, -1, -1})};
  for (size_t v = 0; v < images.size(); ++v)
    tokens.push_back(EncodeImage(p_.cameras[v], images[v]));
  if (config_.pi05()) tokens.push_back(EncodeStateWords(state));
  tokens.push_back(torch::embedding(p_.words, words) *
                   std::sqrt(static_cast<double>(config_.prefix_width)));
  Tensor x = torch::cat(tokens, 1);  // [B, P, w]
  const int64_t length = x.size(1);

  Prefix prefix;
  prefix.context.state = state;
  prefix.context.prefix_mask =
      torch::cat({torch::ones({batch, length - words.size(1)}, torch::kBool), words.ne(0)}, 1);
  const Tensor bias =
      torch::where(prefix.context.prefix_mask, 0.0f, kMaskedBias).unsqueeze(1);  // [B, 1, P]
  // Padding comes last, so a token's position is its index.
  const Tensor position = torch::arange(length).repeat({batch});
  const double scale = 1.0 / std::sqrt(static_cast<double>(h));

  Tensor delta;  // what the last sub-layer adds to x
  for (int i = 0; i < config_.layers; ++i) {
    const NanoLayer& layer = p_.prefix[i];
    const bool last = i + 1 == config_.layers;
    Tensor normed;
    std::tie(x, normed) = AddRmsNorm(x, delta, layer.input_norm.weight);
    if (last && with_aux) {
      const Tensor readout =
          AddRmsNorm(x.narrow(1, 0, config_.readout_tokens), Tensor(), p_.aux_norm).second;
      prefix.aux = torch::linear(readout.flatten(1), p_.aux_weight, p_.aux_bias);
    }
    const auto [q, k, v] = SplitRope(torch::linear(normed, layer.qkv_proj), rope_cos_, rope_sin_,
                                     position, last ? 0 : heads, scale);
    prefix.context.keys.push_back(k.unsqueeze(1));
    prefix.context.values.push_back(v.unsqueeze(1));
    if (last) break;
    // One key head serves all query heads: rows of q are (token, head).
    const Tensor attention =
        SoftmaxBias(torch::bmm(q, k.transpose(1, 2)), bias, heads);  // [B, P H, P]
    delta = torch::linear(torch::bmm(attention, v).view({batch, length, heads * h}), layer.o_proj);
    std::tie(x, normed) = AddRmsNorm(x, delta, layer.post_norm.weight);
    delta = torch::linear(GeGlu(torch::linear(normed, layer.gate_up_proj)), layer.down_proj);
  }
  return prefix;
}

// pi05: the actions. pi0: the state, then actions with the time mixed in; the time half of
// action_time_mlp_in is the same for all tokens of a row, so it is multiplied once.
Tensor NanoNetwork::EmbedSuffix(const Tensor& state, const Tensor& x_u, const Tensor& u) const {
  const int64_t rows = state.size(0), batch = x_u.size(0), draws = batch / rows;
  const int64_t e = config_.expert_width;
  const Tensor action = torch::linear(x_u.reshape({batch, config_.action_tokens(), -1}),
                                      p_.action_in_weight, p_.action_in_bias);
  if (config_.pi05()) return action;
  const Tensor time =
      torch::linear(TimeEmbedding(u, e), p_.time_in_weight.narrow(1, e, e), p_.time_in_bias);
  const Tensor mixed = torch::linear(action, p_.time_in_weight.narrow(1, 0, e)) + time.unsqueeze(1);
  const Tensor timed = torch::linear(torch::silu(mixed), p_.time_out_weight, p_.time_out_bias);
  const Tensor token = torch::linear(state, p_.state_weight, p_.state_bias);  // [rows, e]
  return torch::cat(
      {token.view({rows, 1, 1, e}).expand({rows, draws, 1, e}).reshape({batch, 1, e}), timed}, 1);
}

Tensor NanoNetwork::Velocity(const PolicyContext& context, const Tensor& x_u, const Tensor& u,
                             const LoraWeights* lora) const {
  const int64_t rows = context.state.size(0), batch = x_u.size(0), draws = batch / rows;
  const int64_t actions = config_.action_tokens(), length = config_.suffix_tokens();
  const int64_t heads = config_.heads, h = config_.head_dim;
  const int64_t prefix = context.prefix_mask.size(1);
  RS_CHECK(rows * draws == batch && u.size(0) == batch);

  Tensor x = EmbedSuffix(context.state, x_u, u);
  const Tensor cond = config_.pi05() ? TimeCondition(p_, u) : Tensor();  // [batch, e]

  // Positions go on after the valid prefix tokens; the state sees prefix and itself, actions see
  // everything.
  const Tensor first = context.prefix_mask.sum(1, true);  // [rows, 1]
  const Tensor position = (first + torch::arange(length))
                              .unsqueeze(1)
                              .expand({rows, draws, length})
                              .flatten();  // [batch T]
  const double scale = 1.0 / std::sqrt(static_cast<double>(h));
  Tensor suffix_bias = torch::zeros({length, length});
  if (!config_.pi05()) suffix_bias[0].narrow(0, 1, actions).fill_(kMaskedBias);
  const Tensor prefix_bias = torch::where(context.prefix_mask, 0.0f, kMaskedBias);  // [rows, P]
  const Tensor bias =
      torch::cat({prefix_bias.view({rows, 1, prefix}).expand({rows, length, prefix}),
                  suffix_bias.unsqueeze(0).expand({rows, length, length})},
                 2);  // [rows, T, P + T]

  Tensor delta;
  for (int i = 0; i < config_.layers; ++i) {
    const NanoLayer& layer = p_.expert[i];
    const size_t target = static_cast<size_t>(i) * kTargetsPerLayer;
    const Normed before = AddNorm(x, delta, layer.input_norm, cond);
    const auto [q, k, v] = SplitRope(Project(before.y, layer.qkv_proj, lora, target, 3), rope_cos_,
                                     rope_sin_, position, heads, scale);
    const auto join = [&](const Tensor& of_prefix,
                          const Tensor& of_suffix) {  // -> [batch, P + T, h]
      return torch::cat({of_prefix.expand({rows, draws, prefix, h}),
                         of_suffix.view({rows, draws, length, h})},
                        2)
          .view({batch, prefix + length, h});
    };
    const Tensor keys = join(context.keys[i], k), values = join(context.values[i], v);
    const Tensor attention =
        SoftmaxBias(torch::bmm(q, keys.transpose(1, 2)), bias, heads);  // [batch, T H, P + T]
    const Tensor attended = torch::bmm(attention, values).view({batch, length, heads * h});
    delta = Gated(Project(attended, layer.o_proj, lora, target + 3, 1), before.gate);
    const Normed after = AddNorm(before.x, delta, layer.post_norm, cond);
    x = after.x;
    delta = Gated(Project(GeGlu(Project(after.y, layer.gate_up_proj, lora, target + 4, 2)),
                          layer.down_proj, lora, target + 6, 1),
                  after.gate);
  }
  const Tensor normed =
      AddNorm(x, delta, p_.expert_norm, cond).y.narrow(1, length - actions, actions);
  const Tensor out = torch::linear(normed, p_.action_out_weight, p_.action_out_bias);
  return out.reshape({batch, config_.horizon, config_.model_action_dim});
}

}  // namespace robostress
