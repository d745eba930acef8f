#include "server/policies/openpi/openpi_weights.h"

#include <torch/types.h>

#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress::openpi {

const char kEmbeddingName[] =
    "paligemma_with_expert.paligemma.model.language_model.embed_tokens.weight";
const char kTiedHeadName[] = "paligemma_with_expert.paligemma.lm_head.weight";
const char kUnusedHeadName[] = "paligemma_with_expert.gemma_expert.lm_head.weight";

void ParameterVisitor::OnLinear(const std::string& name, int64_t in, int64_t out, bool bias,
                                Linear& linear) {
  OnTensor(name + ".weight", {out, in}, linear.weight);
  if (bias) OnTensor(name + ".bias", {out}, linear.bias);
}

namespace {

constexpr char kVision[] = "paligemma_with_expert.paligemma.model.vision_tower.vision_model.";
constexpr char kProjector[] = "paligemma_with_expert.paligemma.model.multi_modal_projector.linear";
constexpr char kPrefix[] = "paligemma_with_expert.paligemma.model.language_model.";
constexpr char kExpert[] = "paligemma_with_expert.gemma_expert.model.";

void VisitLayerNorm(const std::string& name, int64_t width, LayerNorm& norm,
                    ParameterVisitor& visitor) {
  visitor.OnTensor(name + ".weight", {width}, norm.weight);
  visitor.OnTensor(name + ".bias", {width}, norm.bias);
}

void VisitSiglipLayer(const std::string& name, const OpenpiConfig& c, SiglipLayer& layer,
                      ParameterVisitor& visitor) {
  const int64_t w = c.vision_width;
  VisitLayerNorm(name + "layer_norm1", w, layer.norm1, visitor);
  visitor.OnLinear(name + "self_attn.q_proj", w, w, true, layer.q);
  visitor.OnLinear(name + "self_attn.k_proj", w, w, true, layer.k);
  visitor.OnLinear(name + "self_attn.v_proj", w, w, true, layer.v);
  visitor.OnLinear(name + "self_attn.out_proj", w, w, true, layer.out);
  VisitLayerNorm(name + "layer_norm2", w, layer.norm2, visitor);
  visitor.OnLinear(name + "mlp.fc1", w, c.vision_mlp, true, layer.fc1);
  visitor.OnLinear(name + "mlp.fc2", c.vision_mlp, w, true, layer.fc2);
}

void VisitSiglip(const OpenpiConfig& c, Siglip& siglip, ParameterVisitor& visitor) {
  const std::string v = kVision;
  visitor.OnTensor(v + "embeddings.patch_embedding.weight", {c.vision_width, 3, c.patch, c.patch},
                   siglip.patch_weight);
  visitor.OnTensor(v + "embeddings.patch_embedding.bias", {c.vision_width}, siglip.patch_bias);
  visitor.OnTensor(v + "embeddings.position_embedding.weight", {c.patches(), c.vision_width},
                   siglip.position);
  siglip.layers.resize(c.vision_depth);
  for (int64_t i = 0; i < c.vision_depth; ++i) {
    VisitSiglipLayer(absl::StrCat(v, "encoder.layers.", i, "."), c, siglip.layers[i], visitor);
  }
  VisitLayerNorm(v + "post_layernorm", c.vision_width, siglip.post_norm, visitor);
}

void VisitGemmaNorm(const std::string& name, int64_t width, bool adaptive, GemmaNorm& norm,
                    ParameterVisitor& visitor) {
  if (adaptive) {
    visitor.OnLinear(name + ".dense", width, 3 * width, true, norm.dense);
  } else {
    visitor.OnTensor(name + ".weight", {width}, norm.weight);
  }
}

// Width, MLP width and kind of norm of one expert.
struct StackShape {
  int64_t width = 0, mlp = 0;
  bool adaptive = false;
};

void VisitGemmaStack(const std::string& name, const OpenpiConfig& c, const StackShape& s,
                     GemmaStack& stack, ParameterVisitor& visitor) {
  const int64_t queries = c.heads * c.head_dim, keys = c.kv_heads * c.head_dim;
  stack.layers.resize(c.depth);
  for (int64_t i = 0; i < c.depth; ++i) {
    const std::string l = absl::StrCat(name, "layers.", i, ".");
    GemmaLayer& layer = stack.layers[i];
    VisitGemmaNorm(l + "input_layernorm", s.width, s.adaptive, layer.input_norm, visitor);
    visitor.OnLinear(l + "self_attn.q_proj", s.width, queries, false, layer.q);
    visitor.OnLinear(l + "self_attn.k_proj", s.width, keys, false, layer.k);
    visitor.OnLinear(l + "self_attn.v_proj", s.width, keys, false, layer.v);
    visitor.OnLinear(l + "self_attn.o_proj", queries, s.width, false, layer.o);
    VisitGemmaNorm(l + "post_attention_layernorm", s.width, s.adaptive, layer.post_norm, visitor);
    visitor.OnLinear(l + "mlp.gate_proj", s.width, s.mlp, false, layer.gate);
    visitor.OnLinear(l + "mlp.up_proj", s.width, s.mlp, false, layer.up);
    visitor.OnLinear(l + "mlp.down_proj", s.mlp, s.width, false, layer.down);
  }
  VisitGemmaNorm(name + "norm", s.width, s.adaptive, stack.norm, visitor);
}

struct RandomVisitor : ParameterVisitor {
  explicit RandomVisitor(uint64_t seed) : generator(at::detail::createCPUGenerator(seed)) {}
  void OnTensor(const std::string&, const std::vector<int64_t>& shape,
                torch::Tensor& tensor) override {
    double std = 0.1;  // vectors: biases and norms
    if (shape.size() > 1) {
      int64_t in = 1;
      for (size_t i = 1; i < shape.size(); ++i) in *= shape[i];
      std = 1 / std::sqrt(static_cast<double>(in));
    }
    tensor = at::randn(shape, generator) * std;
  }
  at::Generator generator;
};

}  // namespace

void VisitParameters(const OpenpiConfig& c, OpenpiWeights& weights, ParameterVisitor& visitor) {
  VisitSiglip(c, weights.vision, visitor);
  visitor.OnLinear(kProjector, c.vision_width, c.prefix_width, true, weights.projector);
  visitor.OnTensor(kEmbeddingName, {c.vocab, c.prefix_width}, weights.embedding);
  VisitGemmaStack(kPrefix, c, {c.prefix_width, c.prefix_mlp, false}, weights.prefix, visitor);
  VisitGemmaStack(kExpert, c, {c.expert_width, c.expert_mlp, c.pi05}, weights.expert, visitor);
  const int64_t w = c.expert_width;
  visitor.OnLinear("action_in_proj", c.action_dim, w, true, weights.action_in);
  visitor.OnLinear("action_out_proj", w, c.action_dim, true, weights.action_out);
  if (c.pi05) {
    visitor.OnLinear("time_mlp_in", w, w, true, weights.time_in);
    visitor.OnLinear("time_mlp_out", w, w, true, weights.time_out);
  } else {
    visitor.OnLinear("state_proj", c.action_dim, w, true, weights.state);
    visitor.OnLinear("action_time_mlp_in", 2 * w, w, true, weights.time_in);
    visitor.OnLinear("action_time_mlp_out", w, w, true, weights.time_out);
  }
}

OpenpiModel RandomOpenpiModel(const OpenpiConfig& config, uint64_t seed) {
  OpenpiModel model;
  model.config = config;
  RandomVisitor random(seed);
  VisitParameters(config, model.weights, random);
  return model;
}

}  // namespace robostress::openpi
