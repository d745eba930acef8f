#include "server/policies/openpi/openpi_weights.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "server/policies/openpi/problem_list.h"
#include "server/policies/openpi/tensor_io.h"

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

// What a file must hold: name, shape.
struct ShapeCollector : ParameterVisitor {
  void OnTensor(const std::string& name, const std::vector<int64_t>& shape,
                torch::Tensor&) override {
    shapes.emplace_back(name, shape);
  }
  std::vector<std::pair<std::string, std::vector<int64_t>>> shapes;
};

// The tensor that holds `name`, which for the embedding may go by its tied name; null when absent.
const TensorView* FindStored(const SafetensorsFile& file, const std::string& name) {
  auto found = file.tensors().find(name);
  if (found == file.tensors().end() && name == kEmbeddingName)
    found = file.tensors().find(kTiedHeadName);
  return found == file.tensors().end() ? nullptr : &found->second;
}

// The two names of the tied embedding must not disagree.
std::string TiedProblem(const SafetensorsFile& file) {
  const auto table = file.tensors().find(kEmbeddingName);
  const auto head = file.tensors().find(kTiedHeadName);
  if (table == file.tensors().end() || head == file.tensors().end()) return "";
  if (table->second.dtype == head->second.dtype && table->second.bytes == head->second.bytes)
    return "";
  return absl::StrCat("contradictory: ", kEmbeddingName, " and ", kTiedHeadName,
                      " are one tied tensor but hold different bytes");
}

// Everything that keeps the file from being this network.
absl::Status CheckFits(const SafetensorsFile& file, const OpenpiConfig& config) {
  ShapeCollector wanted;
  OpenpiWeights nothing;
  VisitParameters(config, nothing, wanted);
  if (std::none_of(wanted.shapes.begin(), wanted.shapes.end(),
                   [&](const auto& tensor) { return FindStored(file, tensor.first) != nullptr; })) {
    return absl::InvalidArgumentError(absl::StrCat(
        file.path(), ": holds none of the tensors of a ", config.name(),
        " network, so it is no weights file; give the one with openpi's tensor names"));
  }
  std::vector<std::string> problems;
  std::set<std::string> known = {kTiedHeadName, kUnusedHeadName};
  for (const auto& [name, shape] : wanted.shapes) {
    known.insert(name);
    const TensorView* stored = FindStored(file, name);
    if (stored == nullptr) {
      problems.push_back(absl::StrCat("missing: ", name, " ", ShapeText(shape)));
    } else if (stored->shape != shape) {
      problems.push_back(absl::StrCat("misshaped: ", name, " is ", ShapeText(stored->shape),
                                      ", the configuration asks for ", ShapeText(shape)));
    } else if (stored->dtype != DType::kF32 && stored->dtype != DType::kBF16 &&
               stored->dtype != DType::kF16) {
      problems.push_back(absl::StrCat("dtype: ", name, " is ", DTypeName(stored->dtype),
                                      ", must be F32, BF16 or F16"));
    }
  }
  for (const auto& [name, view] : file.tensors()) {
    if (!known.contains(name))
      problems.push_back(absl::StrCat("unexpected: ", name, " ", ShapeText(view.shape)));
  }
  if (std::string problem = TiedProblem(file); !problem.empty()) problems.push_back(problem);
  return ProblemList(file.path(),
                     absl::StrCat("its tensors do not make the ", config.name(),
                                  " network of its metadata 'config'"),
                     problems,
                     "Take a file with openpi's tensor names whose 'config' belongs to it; `pi05` "
                     "in it decides which "
                     "of the two networks is meant");
}

struct LoadVisitor : ParameterVisitor {
  explicit LoadVisitor(const SafetensorsFile& f) : file(f) {}
  void OnTensor(const std::string& name, const std::vector<int64_t>&,
                torch::Tensor& tensor) override {
    if (!status.ok()) return;
    auto loaded =
        ToFiniteFloats(absl::StrCat(file.path(), ": tensor '", name, "'"), *FindStored(file, name));
    if (loaded.ok()) {
      tensor = *std::move(loaded);
    } else {
      status = loaded.status();
    }
  }
  const SafetensorsFile& file;
  absl::Status status;
};

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

absl::StatusOr<OpenpiModel> LoadOpenpiModel(const SafetensorsFile& file) {
  OpenpiModel model;
  RS_ASSIGN_OR_RETURN(model.config, OpenpiConfigOf(file));
  RS_RETURN_IF_ERROR(CheckFits(file, model.config));
  LoadVisitor load(file);
  VisitParameters(model.config, model.weights, load);
  RS_RETURN_IF_ERROR(load.status);
  return model;
}

absl::StatusOr<OpenpiModel> LoadOpenpiModel(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  return LoadOpenpiModel(file);
}

OpenpiModel RandomOpenpiModel(const OpenpiConfig& config, uint64_t seed) {
  OpenpiModel model;
  model.config = config;
  RandomVisitor random(seed);
  VisitParameters(config, model.weights, random);
  return model;
}

}  // namespace robostress::openpi
