#include "server/policies/openpi/euler_steps.h"

#include <torch/types.h>

#include "server/policies/openpi/masks.h"

namespace robostress::openpi {
namespace {

constexpr size_t kTargetsPerLayer = 7;  // q, k, v, o, gate, up, down

// [1, S, S] additive: the state sees itself, actions see everything. Undefined for pi0.5.
torch::Tensor SuffixBlocks(const OpenpiConfig& c) {
  if (c.pi05) return {};
  torch::Tensor valid = at::ones({1, c.suffix_tokens()}, torch::kBool);
  torch::Tensor starts = at::zeros({1, c.suffix_tokens()}, torch::kBool);
  starts.narrow(1, 0, 2).fill_(true);
  return AdditiveMask(BlockMask(valid, starts)).squeeze(1);
}

// Suffix tokens of a step, [B S, w] between layers' dtype.
torch::Tensor EmbedStep(const InferenceSetup& setup, const InferenceWeights& w, size_t step,
                        const StepBuffers& buffers) {
  const int64_t batch = buffers.x.size(0), width = setup.config.expert_width;
  torch::Tensor actions = Project(w.action_in, buffers.x);  // [B K, w]
  if (setup.config.pi05) return actions.to(setup.activations);
  const torch::Tensor mixed =
      Project(w.time_in, actions).add_(w.time_bias[static_cast<int64_t>(step)]);
  actions = Project(w.time_out, at::silu(mixed)).view({batch, setup.config.horizon, width});
  return at::cat({buffers.state_token, actions}, 1).view({-1, width}).to(setup.activations);
}

// v(x, t_step) [B, K, d].
torch::Tensor StepVelocity(const InferenceSetup& setup, const InferenceWeights& w, size_t step,
                           const StepBuffers& buffers) {
  const OpenpiConfig& c = setup.config;
  const int64_t batch = buffers.x.size(0), suffix = c.suffix_tokens();
  const int64_t prefix = buffers.keys[0].size(1) - suffix;
  const Rotary rotary = {buffers.cos, buffers.sin, buffers.rows};
  const std::vector<Modulation>& norms = w.expert.NormsAt(step);
  torch::Tensor x = EmbedStep(setup, w, step, buffers);
  torch::Tensor branch, gate;  // what the sub-layer before adds to x
  for (size_t i = 0; i < w.expert.layers.size(); ++i) {
    const InferenceLayer& layer = w.expert.layers[i];
    const size_t target = i * kTargetsPerLayer;
    const Modulation &before_attention = norms[2 * i], &before_mlp = norms[2 * i + 1];
    const torch::Tensor qkv = Project(layer.qkv, AddAndNormalise(x, branch, gate, before_attention),
                                      buffers.adapters, target, batch);
    const Heads heads = SplitHeads(qkv, batch, setup.shape(), c.heads, &rotary);
    buffers.keys[i].narrow(1, prefix, suffix).copy_(heads.k);
    buffers.values[i].narrow(1, prefix, suffix).copy_(heads.v);
    const torch::Tensor attended =
        Attend(heads.q, buffers.keys[i], buffers.values[i], buffers.mask, batch, setup.shape());
    branch = Project(layer.o, attended, buffers.adapters, target + 3, batch);
    const torch::Tensor gate_up =
        Project(layer.gate_up, AddAndNormalise(x, branch, before_attention.gate, before_mlp),
                buffers.adapters, target + 4, batch);
    branch = Project(layer.down, GeGlu(gate_up), buffers.adapters, target + 6, batch);
    gate = before_mlp.gate;
  }
  const torch::Tensor out = AddAndNormalise(x, branch, gate, norms.back())
                                .view({batch, suffix, c.expert_width})
                                .narrow(1, suffix - c.horizon, c.horizon);
  return Project(w.action_out, out.to(torch::kFloat32)).view_as(buffers.x);
}

}  // namespace

StepShape ShapeOfPrediction(const PolicyContext& context, const Adapters& adapters,
                            int64_t prefix) {
  StepShape shape;
  shape.batch = context.prefix_mask.size(0);
  shape.prefix = prefix;
  shape.masked = prefix != context.prefix_mask.size(1) || !context.prefix_mask.all().item<bool>();
  shape.rows = adapters.rows;
  for (size_t i = 0; i < adapters.A.size(); ++i) {
    shape.adapter.push_back(adapters.A[i].sizes().vec());
    shape.adapter.push_back(adapters.B[i].sizes().vec());
  }
  return shape;
}

StepBuffers AllocateSteps(const InferenceSetup& setup, const StepShape& shape) {
  const OpenpiConfig& c = setup.config;
  const int64_t suffix = c.suffix_tokens(), slots = shape.prefix + suffix, batch = shape.batch;
  const auto floats = torch::TensorOptions(setup.device).dtype(torch::kFloat32);
  StepBuffers buffers;
  for (int64_t i = 0; i < c.depth; ++i) {
    const auto slots_of = [&] {
      return at::zeros({batch * c.kv_heads, slots, c.head_dim}, floats.dtype(setup.activations));
    };
    buffers.keys.push_back(slots_of());
    buffers.values.push_back(slots_of());
  }
  if (shape.masked || !c.pi05) {
    buffers.mask = at::zeros({shape.masked ? batch : 1, c.pi05 ? 1 : suffix, slots}, floats);
    if (!c.pi05) buffers.mask.narrow(2, shape.prefix, suffix).copy_(SuffixBlocks(c));
  }
  buffers.cos = at::empty({batch * suffix, c.head_dim / 2}, floats);
  buffers.sin = at::empty_like(buffers.cos);
  buffers.rows = at::arange(batch * suffix, floats.dtype(torch::kInt64));
  buffers.x = at::empty({batch, c.horizon, c.action_dim}, floats);
  if (!c.pi05) buffers.state_token = at::empty({batch, 1, c.expert_width}, floats);
  buffers.adapters.rows = shape.rows;
  for (size_t i = 0; i < shape.adapter.size(); i += 2) {
    buffers.adapters.A.push_back(at::empty(shape.adapter[i], floats.dtype(setup.activations)));
    buffers.adapters.B.push_back(at::empty(shape.adapter[i + 1], floats.dtype(setup.activations)));
  }
  return buffers;
}

void FillSteps(const InferenceSetup& setup, const InferenceWeights& weights,
               const PolicyContext& context, const torch::Tensor& noise, const Adapters& adapters,
               StepBuffers& buffers) {
  const OpenpiConfig& c = setup.config;
  const int64_t given = context.prefix_mask.size(1), suffix = c.suffix_tokens();
  const auto put = [&](torch::Tensor& slots, const torch::Tensor& prefix) {
    slots.narrow(1, 0, given).copy_(prefix.reshape({slots.size(0), given, c.head_dim}));
  };
  for (size_t i = 0; i < buffers.keys.size(); ++i) {
    put(buffers.keys[i], context.keys[i]);
    put(buffers.values[i], context.values[i]);
  }
  const torch::Tensor mask = context.prefix_mask.to(torch::kCPU);
  if (buffers.mask.defined()) {
    const int64_t slots = buffers.keys[0].size(1) - suffix;
    torch::Tensor all = at::zeros({mask.size(0), slots}, torch::kBool);
    all.narrow(1, 0, given).copy_(mask);
    if (buffers.mask.size(0) == mask.size(0))
      buffers.mask.narrow(2, 0, slots).copy_(KeyMask(all, torch::kCPU));
  }
  const torch::Tensor positions = mask.sum(1, /*keepdim=*/true) + at::arange(suffix);  // [B, S]
  const Rotary rotary = MakeRotary(positions.flatten(), c.head_dim);
  buffers.cos.copy_(rotary.cos);
  buffers.sin.copy_(rotary.sin);
  buffers.x.copy_(noise);
  if (!c.pi05) {
    const torch::Tensor state = context.state.to(setup.device, torch::kFloat32);
    buffers.state_token.copy_(Project(weights.state, state).unsqueeze(1));
  }
  for (size_t i = 0; i < adapters.A.size(); ++i) {
    buffers.adapters.A[i].copy_(adapters.A[i]);
    buffers.adapters.B[i].copy_(adapters.B[i]);
  }
}

void RunSteps(const InferenceSetup& setup, const InferenceWeights& weights, int64_t steps,
              StepBuffers& buffers) {
  for (int64_t step = 0; step < steps; ++step) {
    buffers.x.add_(StepVelocity(setup, weights, static_cast<size_t>(step), buffers),
                   static_cast<float>(-1.0 / static_cast<double>(steps)));
  }
}

}  // namespace robostress::openpi
