#include "server/policies/nano/nano_sampler.h"

#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "common/check.h"
#include "server/policies/kernels/fused_kernels.h"

namespace robostress {
namespace {

constexpr size_t kTargetsPerLayer = 7;
// Predictions computed together: each matrix is read once for all of them. More gain nothing (the
// activations leave the cache).
constexpr int64_t kTogether = 8;

std::vector<float> ToVector(const torch::Tensor& tensor) {
  const torch::Tensor flat = tensor.detach().to(torch::kFloat32).contiguous();
  return {flat.data_ptr<float>(), flat.data_ptr<float>() + flat.numel()};
}

// Calls f(value, per_column[i]) for every entry i of every row.
template <class F>
void ForEachEntry(int64_t rows, int64_t width, const std::vector<float>& per_column,
                  std::vector<float>& values, F&& f) {
  for (int64_t r = 0; r < rows; ++r) {
    for (int64_t i = 0; i < width; ++i) f(values[r * width + i], per_column[i]);
  }
}

// Value of row-major W [out, in] goes to panel out / 16, place [in][out % 16].
float& PanelAt(float* panels, int64_t in, int64_t out_index, int64_t in_index) {
  return panels[(out_index / kPanel * in + in_index) * kPanel + out_index % kPanel];
}

}  // namespace

struct NanoSampler::Lora {
  // One pair of matrices: reads `in` inputs from `first_in` on, adds to `out` outputs from
  // `first_out` on. A target per head has one for each head.
  struct Pair {
    int64_t first_in, in, first_out, out, rank;
    std::vector<float> a, b_transposed;
  };
  struct Target {
    int64_t in, out;
    std::vector<Pair> pairs;
  };
  Lora(const std::vector<LoraTarget>& shapes, const LoraWeights& weights) {
    for (size_t i = 0; i < shapes.size(); ++i) {
      const torch::Tensor A = weights.A[i].detach().to(torch::kFloat32).contiguous(),
                          B = weights.B[i].detach().to(torch::kFloat32).contiguous();
      Target target{shapes[i].in_features, shapes[i].out_features, {}};
      const int64_t pairs = A.dim() == 2 ? 1 : A.size(0), rank = A.size(-2), in = A.size(-1),
                    out = B.size(-2);
      for (int64_t n = 0; n < pairs; ++n) {
        Pair pair{
            in < target.in ? n * in : 0, in, out < target.out ? n * out : 0, out, rank, {}, {}};
        const float* a = A.data_ptr<float>() + n * rank * in;
        const float* b = B.data_ptr<float>() + n * out * rank;
        pair.a.assign(a, a + rank * in);
        pair.b_transposed.resize(rank * out);
        for (int64_t o = 0; o < out; ++o) {
          for (int64_t r = 0; r < rank; ++r) pair.b_transposed[r * out + o] = b[o * rank + r];
        }
        target.pairs.push_back(std::move(pair));
      }
      targets.push_back(std::move(target));
    }
  }
  std::vector<Target> targets;
};

// Buffers of `batch` predictions that are computed together. Key slots of each: prefix, state,
// filled up to a panel; then actions, filled up to a panel.
struct NanoSampler::Workspace {
  Workspace(const NanoConfig& c, int64_t prefix, int64_t batch)
      : slots(PadToPanel(prefix + 1) + PadToPanel(c.action_tokens())),
        keys(batch * c.layers, std::vector<float>(slots * c.head_dim)),
        values(batch * c.layers, std::vector<float>(slots * PadToPanel(c.head_dim))) {
    const int64_t tokens_each = std::max(1, c.action_tokens()), rows = batch * tokens_each;
    tokens.resize(rows * c.expert_width);
    sum.resize(tokens.size());
    delta.resize(tokens.size());
    normed.resize(tokens.size());
    inverse_rms.resize(rows);
    qkv.resize(rows * (c.heads + 2) * c.head_dim);
    q.resize(rows * c.heads * c.head_dim);
    k.resize(rows * c.head_dim);
    v.resize(rows * c.head_dim);
    attended.resize(q.size());
    scores.resize(tokens_each * c.heads * slots);
    gate_up.resize(rows * 2 * c.expert_mlp);
    hidden.resize(rows * c.expert_mlp);
    positions.resize(rows);
  }
  int64_t slots;
  // Per layer of each prediction.
  std::vector<std::vector<float>> keys;    // packed as weights [slots, head_dim]
  std::vector<std::vector<float>> values;  // packed as weights [head_dim, slots]
  std::vector<float> tokens, sum, delta, normed, inverse_rms, qkv, q, k, v, attended, scores,
      gate_up, hidden;
  std::vector<int64_t> positions;

  void PutKey(size_t place, int64_t slot, const float* key, const float* value, int64_t h) {
    for (int64_t i = 0; i < h; ++i) {
      PanelAt(keys[place].data(), h, slot, i) = key[i];
      PanelAt(values[place].data(), slots, i, slot) = value[i];
    }
  }
};

// One of the predictions that are computed together.
struct NanoSampler::Item {
  const Lora* lora = nullptr;
  int64_t valid = 0;                           // prefix tokens that count
  std::vector<float> state_bias, action_bias;  // [slots] what a query of the kind may see
};

NanoSampler::Packed NanoSampler::Pack(const torch::Tensor& weight, const torch::Tensor& bias) {
  const std::vector<float> values = ToVector(weight);
  Packed packed;
  packed.out = weight.size(0);
  packed.in = weight.size(1);
  packed.panels.resize(PadToPanel(packed.out) * packed.in);
  for (int64_t o = 0; o < packed.out; ++o) {
    for (int64_t i = 0; i < packed.in; ++i)
      PanelAt(packed.panels.data(), packed.in, o, i) = values[o * packed.in + i];
  }
  if (bias.defined()) packed.bias = ToVector(bias);
  return packed;
}

NanoSampler::NanoSampler(const NanoConfig& config, const NanoParameters& p,
                         const std::vector<float>& times)
    : config_(config), lora_targets_(NanoLoraTargets(config)), times_(times) {
  torch::NoGradGuard no_grad;
  const int64_t e = config.expert_width;
  action_in_ = Pack(p.action_in_weight, p.action_in_bias);
  action_out_ = Pack(p.action_out_weight, p.action_out_bias);
  std::vector<const NanoNorm*> norms;
  for (const NanoLayer& layer : p.expert) {
    norms.push_back(&layer.input_norm);
    norms.push_back(&layer.post_norm);
  }
  norms.push_back(&p.expert_norm);
  if (config.pi05()) {
    const torch::Tensor cond = TimeCondition(p, torch::tensor(times));  // [steps, e]
    norms_.resize(times.size());
    for (const NanoNorm* norm : norms) {
      const auto parts = torch::linear(cond, norm->dense, norm->dense_bias).chunk(3, -1);
      for (size_t i = 0; i < times.size(); ++i) {
        const auto step = static_cast<int64_t>(i);
        norms_[i].push_back(
            {ToVector(parts[0][step]), ToVector(parts[1][step]), ToVector(parts[2][step])});
      }
    }
  } else {
    state_ = Pack(p.state_weight, p.state_bias);
    time_in_ = Pack(p.time_in_weight.narrow(1, 0, e), {});
    time_out_ = Pack(p.time_out_weight, p.time_out_bias);
    const torch::Tensor embedding = TimeEmbedding(torch::tensor(times), e);
    const torch::Tensor time =
        torch::linear(embedding, p.time_in_weight.narrow(1, e, e), p.time_in_bias);
    for (size_t i = 0; i < times.size(); ++i)
      time_bias_.push_back(ToVector(time[static_cast<int64_t>(i)]));
    norms_.resize(1);
    for (const NanoNorm* norm : norms) norms_[0].push_back({ToVector(norm->weight), {}, {}});
  }
  for (const NanoLayer& layer : p.expert) {
    layers_.push_back({Pack(layer.qkv_proj, {}), Pack(layer.o_proj, {}),
                       Pack(layer.gate_up_proj, {}), Pack(layer.down_proj, {})});
  }
  const auto [cos, sin] = RopeTables(config);
  rope_cos_ = ToVector(cos);
  rope_sin_ = ToVector(sin);
}

void NanoSampler::Apply(const Packed& packed, const float* x, int64_t rows, float* y) const {
  BestFusedKernels().linear(x, rows, packed.in, packed.panels.data(), packed.out, y);
  if (packed.bias.empty()) return;
  for (int64_t r = 0; r < rows; ++r) {
    for (int64_t i = 0; i < packed.out; ++i) y[r * packed.out + i] += packed.bias[i];
  }
}

void NanoSampler::AddLora(const std::vector<Item>& items, size_t first, size_t count,
                          const float* x, int64_t rows, float* y, int64_t width) const {
  for (size_t n = 0; n < items.size(); ++n) {
    if (items[n].lora == nullptr) continue;
    int64_t column = 0;
    for (size_t i = first; i < first + count; ++i) {
      const Lora::Target& target = items[n].lora->targets[i];
      const int64_t row = static_cast<int64_t>(n) * rows;
      for (const Lora::Pair& pair : target.pairs) {
        BestFusedKernels().add_low_rank(x + row * target.in + pair.first_in, target.in, rows,
                                        pair.in, pair.a.data(), pair.b_transposed.data(), pair.rank,
                                        pair.out, y + row * width + column + pair.first_out, width);
      }
      column += target.out;
    }
  }
}

void NanoSampler::RunTokens(Workspace& w, const std::vector<Item>& items, Tokens kind,
                            int64_t first_slot, const StepNorms& norms) const {
  const FusedKernels& kernels = BestFusedKernels();
  const int64_t e = config_.expert_width, heads = config_.heads, h = config_.head_dim;
  const int64_t rows = kind == Tokens::kState ? 1 : config_.action_tokens();  // of each item
  const int64_t all = rows * static_cast<int64_t>(items.size());
  const int64_t state_tokens = kind == Tokens::kAction && !config_.pi05() ? 1 : 0;
  for (size_t n = 0; n < items.size(); ++n) {
    for (int64_t i = 0; i < rows; ++i)
      w.positions[n * rows + i] = items[n].valid + state_tokens + i;
  }
  const float q_scale = static_cast<float>(1.0 / std::sqrt(static_cast<double>(h)));
  const Norm* before = nullptr;  // the norm whose branch is in delta
  // tokens += gate * delta, normed = the norm of that.
  const auto norm = [&](const Norm& n) {
    if (before != nullptr && !before->gate.empty())
      ForEachEntry(all, e, before->gate, w.delta, [](float& x, float gate) { x *= gate; });
    kernels.add_rms_norm(w.tokens.data(), before != nullptr ? w.delta.data() : nullptr,
                         n.scale.data(), all, e, w.sum.data(), w.normed.data(),
                         w.inverse_rms.data());
    if (before != nullptr) w.tokens.swap(w.sum);
    if (!n.shift.empty())
      ForEachEntry(all, e, n.shift, w.normed, [](float& y, float shift) { y += shift; });
    before = &n;
  };
  // Each item attends to its own prefix and its own tokens.
  const auto attend = [&](int layer) {
    for (size_t n = 0; n < items.size(); ++n) {
      const size_t place = n * config_.layers + layer, row = n * rows;
      for (int64_t r = 0; r < rows; ++r) {
        w.PutKey(place, first_slot + r, w.k.data() + (row + r) * h, w.v.data() + (row + r) * h, h);
      }
      const std::vector<float>& bias =
          kind == Tokens::kState ? items[n].state_bias : items[n].action_bias;
      kernels.linear(w.q.data() + row * heads * h, rows * heads, h, w.keys[place].data(), w.slots,
                     w.scores.data());
      kernels.softmax_bias(w.scores.data(), bias.data(), 1, rows * heads, w.slots, heads, 1, 1);
      kernels.linear(w.scores.data(), rows * heads, w.slots, w.values[place].data(), h,
                     w.attended.data() + row * heads * h);
    }
  };
  for (int i = 0; i < config_.layers; ++i) {
    const Layer& layer = layers_[i];
    const size_t target = i * kTargetsPerLayer;
    norm(norms[2 * i]);
    Apply(layer.qkv, w.normed.data(), all, w.qkv.data());
    AddLora(items, target, 3, w.normed.data(), rows, w.qkv.data(), layer.qkv.out);
    kernels.split_rope(w.qkv.data(), rope_cos_.data(), rope_sin_.data(), w.positions.data(),
                       q_scale, all, heads, h, false, w.q.data(), w.k.data(), w.v.data());
    attend(i);
    Apply(layer.o, w.attended.data(), all, w.delta.data());
    AddLora(items, target + 3, 1, w.attended.data(), rows, w.delta.data(), e);
    norm(norms[2 * i + 1]);
    Apply(layer.gate_up, w.normed.data(), all, w.gate_up.data());
    AddLora(items, target + 4, 2, w.normed.data(), rows, w.gate_up.data(), layer.gate_up.out);
    kernels.geglu(w.gate_up.data(), all, config_.expert_mlp, w.hidden.data());
    Apply(layer.down, w.hidden.data(), all, w.delta.data());
    AddLora(items, target + 6, 1, w.hidden.data(), rows, w.delta.data(), e);
  }
  norm(norms.back());
}

// pi05: the actions. pi0: with the time mixed in.
void NanoSampler::EmbedActions(size_t step, const float* x, int64_t tokens,
                               std::vector<float>& mixed, Workspace& w) const {
  const int64_t e = config_.expert_width;
  Apply(action_in_, x, tokens, w.tokens.data());
  if (config_.pi05()) return;
  Apply(time_in_, w.tokens.data(), tokens, mixed.data());
  ForEachEntry(tokens, e, time_bias_[step], mixed, [](float& value, float bias) {
    value += bias;
    value = value / (1.0f + std::exp(-value));
  });
  Apply(time_out_, mixed.data(), tokens, w.tokens.data());
}

// Copies a row's prefix into the workspace and says what its tokens may see.
NanoSampler::Item NanoSampler::PutPrefix(const PolicyContext& context, int64_t row, size_t n,
                                         Workspace& w) const {
  const int64_t prefix = context.prefix_mask.size(1), h = config_.head_dim;
  for (int i = 0; i < config_.layers; ++i) {
    const torch::Tensor keys = context.keys[i][row].contiguous(),
                        values = context.values[i][row].contiguous();
    for (int64_t slot = 0; slot < prefix; ++slot) {
      w.PutKey(n * config_.layers + i, slot, keys.data_ptr<float>() + slot * h,
               values.data_ptr<float>() + slot * h, h);
    }
  }
  // The state sees prefix and itself, an action sees everything but the filling.
  const torch::Tensor mask = context.prefix_mask[row].contiguous();
  Item item;
  item.state_bias.assign(w.slots, kMaskedBias);
  for (int64_t slot = 0; slot < prefix; ++slot) {
    if (!mask.data_ptr<bool>()[slot]) continue;
    item.state_bias[slot] = 0.0f;
    ++item.valid;
  }
  if (!config_.pi05()) item.state_bias[prefix] = 0.0f;
  item.action_bias = item.state_bias;
  std::fill_n(item.action_bias.begin() + PadToPanel(prefix + 1), config_.action_tokens(), 0.0f);
  return item;
}

void NanoSampler::SampleTogether(const PolicyContext& context, int64_t first_row,
                                 const std::vector<const Lora*>& lora, float* x) const {
  const int64_t prefix = context.prefix_mask.size(1), e = config_.expert_width;
  const auto batch = static_cast<int64_t>(lora.size());
  const int64_t tokens = batch * config_.action_tokens();
  Workspace w(config_, prefix, batch);
  std::vector<Item> items;
  for (int64_t n = 0; n < batch; ++n) {
    items.push_back(PutPrefix(context, first_row + n, n, w));
    items.back().lora = lora[n];
  }
  if (!config_.pi05()) {
    const torch::Tensor state = context.state.narrow(0, first_row, batch).contiguous();
    Apply(state_, state.data_ptr<float>(), batch, w.tokens.data());
    RunTokens(w, items, Tokens::kState, prefix, norms_[0]);
  }

  std::vector<float> mixed(tokens * e);
  std::vector<float> velocity(tokens * config_.steps_per_token * config_.model_action_dim);
  for (size_t step = 0; step < times_.size(); ++step) {
    EmbedActions(step, x, tokens, mixed, w);
    RunTokens(w, items, Tokens::kAction, PadToPanel(prefix + 1), norms_[config_.pi05() ? step : 0]);
    Apply(action_out_, w.normed.data(), tokens, velocity.data());
    const float dt = -1.0f / static_cast<float>(times_.size());
    for (size_t i = 0; i < velocity.size(); ++i) x[i] += dt * velocity[i];
  }
}

torch::Tensor NanoSampler::Sample(const PolicyContext& context, const torch::Tensor& noise,
                                  const std::vector<const LoraWeights*>& lora) const {
  torch::NoGradGuard no_grad;
  RS_CHECK(noise.size(0) == context.state.size(0) &&
           noise.size(0) == static_cast<int64_t>(lora.size()) && noise.size(1) == config_.horizon &&
           noise.size(2) == config_.model_action_dim);
  const torch::Tensor x = noise.to(torch::kFloat32).contiguous().clone();
  std::map<const LoraWeights*, Lora> packed;
  for (const LoraWeights* weights : lora) {
    if (weights != nullptr && !packed.contains(weights))
      packed.emplace(weights, Lora(lora_targets_, *weights));
  }
  const int64_t size = noise.size(1) * noise.size(2);
  for (int64_t first = 0; first < noise.size(0); first += kTogether) {
    std::vector<const Lora*> together;
    for (int64_t row = first; row < std::min(first + kTogether, noise.size(0)); ++row) {
      const auto found = packed.find(lora[row]);
      together.push_back(found == packed.end() ? nullptr : &found->second);
    }
    SampleTogether(context, first, together, x.data_ptr<float>() + first * size);
  }
  return x;
}

}  // namespace robostress
