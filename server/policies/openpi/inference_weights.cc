#include "server/policies/openpi/inference_weights.h"

#include <torch/types.h>

#include "server/policies/openpi/flow.h"

namespace robostress::openpi {
namespace {

Projection Single(const Linear& linear) { return Projection::Join({linear}, 0); }

// The expert's products have few rows: as many as there are actions.
void PackSmall(InferenceStack& expert, int64_t limit) {
  for (InferenceLayer& layer : expert.layers) {
    for (Projection* projection : {&layer.qkv, &layer.o, &layer.gate_up, &layer.down})
      *projection = std::move(*projection).Packed(limit);
  }
}

// The modulation of a norm at every time; one entry where it does not depend on the time.
std::vector<Modulation> Modulations(const GemmaNorm& norm, const torch::Tensor& cond,
                                    torch::Dtype activations) {
  if (!norm.dense.weight.defined()) return {{norm.weight, {}, {}}};
  std::vector<Modulation> modulations;
  for (const torch::Tensor& row : Apply(norm.dense, cond).unbind(0)) {  // [3 w]
    const auto parts = row.chunk(3);
    modulations.push_back({parts[0], parts[1], parts[2].to(activations)});
  }
  return modulations;
}

// cond [steps, w] of the adaptive norms, else undefined.
InferenceStack PrepareStack(const GemmaStack& stack, const torch::Tensor& cond,
                            torch::Dtype activations, int64_t limit, bool only_keys_of_last) {
  InferenceStack prepared;
  std::vector<std::vector<Modulation>> by_norm;
  for (size_t i = 0; i < stack.layers.size(); ++i) {
    const GemmaLayer& layer = stack.layers[i];
    by_norm.push_back(Modulations(layer.input_norm, cond, activations));
    by_norm.push_back(Modulations(layer.post_norm, cond, activations));
    if (only_keys_of_last && i + 1 == stack.layers.size()) {
      prepared.layers.push_back({Projection::Join({layer.k, layer.v}, limit), {}, {}, {}});
      break;
    }
    prepared.layers.push_back({Projection::Join({layer.q, layer.k, layer.v}, limit),
                               Single(layer.o), Projection::Join({layer.gate, layer.up}, limit),
                               Single(layer.down)});
  }
  by_norm.push_back(Modulations(stack.norm, cond, activations));
  prepared.norms.resize(by_norm.front().size());
  for (size_t step = 0; step < prepared.norms.size(); ++step) {
    for (const auto& modulations : by_norm) prepared.norms[step].push_back(modulations[step]);
  }
  return prepared;
}

// Columns first ... first + count - 1 of what `linear` reads, without its bias.
Linear Columns(const Linear& linear, int64_t first, int64_t count) {
  Linear part = linear;
  part.weight = linear.weight.narrow(1, first, count).contiguous();
  if (linear.lora_A.defined()) part.lora_A = linear.lora_A.narrow(1, first, count).contiguous();
  part.bias = torch::Tensor();
  return part;
}

}  // namespace

std::vector<float> EulerTimes(int64_t steps) {
  std::vector<float> times;
  const float dt = static_cast<float>(-1.0 / static_cast<double>(steps));
  for (float t = 1.0f; t >= -dt / 2; t += dt) times.push_back(t);
  return times;
}

InferenceWeights PrepareWeights(const OpenpiModel& model, const std::vector<float>& times,
                                torch::Dtype activations, int64_t join_limit_bytes) {
  const OpenpiWeights& w = model.weights;
  InferenceWeights prepared;
  prepared.patch_weight = w.vision.patch_weight;
  prepared.patch_bias = w.vision.patch_bias;
  prepared.position = w.vision.position;
  for (const SiglipLayer& layer : w.vision.layers) {
    prepared.vision.push_back({layer.norm1, layer.norm2,
                               Projection::Join({layer.q, layer.k, layer.v}, join_limit_bytes),
                               Single(layer.out), Single(layer.fc1), Single(layer.fc2)});
  }
  prepared.vision_norm = w.vision.post_norm;
  prepared.projector = Single(w.projector);
  prepared.embedding = w.embedding;
  prepared.prefix = PrepareStack(w.prefix, {}, activations, join_limit_bytes, true);
  prepared.action_in = Single(w.action_in);
  prepared.action_out = Single(w.action_out);
  const torch::Tensor t = torch::tensor(times).to(w.action_in.weight.device());
  if (model.config.pi05) {
    prepared.expert =
        PrepareStack(w.expert, TimeCondition(model, t), activations, join_limit_bytes, false);
    PackSmall(prepared.expert, join_limit_bytes);
    return prepared;
  }
  prepared.expert = PrepareStack(w.expert, {}, activations, join_limit_bytes, false);
  PackSmall(prepared.expert, join_limit_bytes);
  const int64_t width = model.config.expert_width;
  Linear of_time = Columns(w.time_in, width, width);
  of_time.bias = w.time_in.bias;
  prepared.time_bias = Apply(of_time, EmbedTime(t, width));
  prepared.time_in = Single(Columns(w.time_in, 0, width));
  prepared.time_out = Single(w.time_out);
  prepared.state = Single(w.state);
  return prepared;
}

}  // namespace robostress::openpi
