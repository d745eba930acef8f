#include "server/policies/openpi/openpi_lora.h"

#include <torch/types.h>

#include <cmath>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/check.h"
#include "common/status_macros.h"
#include "server/policies/openpi/problem_list.h"
#include "server/policies/tensor_io.h"

namespace robostress::openpi {
namespace {

constexpr char kRoot[] = "lora/", kA[] = ".lora_A.weight", kB[] = ".lora_B.weight";

struct Sizes {
  int64_t in = 0, out = 0;
};

// Sizes of every linear layer by name.
struct LinearCollector : ParameterVisitor {
  void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor&) override {}
  void OnLinear(const std::string& name, int64_t in, int64_t out, bool, Linear&) override {
    linears[name] = {in, out};
  }
  std::map<std::string, Sizes> linears;
};

// Hangs pairs on the layers that `targets` name.
struct TargetVisitor : ParameterVisitor {
  TargetVisitor(const OpenpiConfig& config, const std::vector<torch::Tensor>& a,
                const std::vector<torch::Tensor>& b, bool of_rows)
      : A(a), B(b), rows(of_rows) {
    const std::vector<LoraTarget> targets = ExpertLoraTargets(config);
    RS_CHECK(A.size() == targets.size() && B.size() == targets.size());
    for (size_t i = 0; i < targets.size(); ++i) index[targets[i].name] = i;
  }
  void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor&) override {}
  void OnLinear(const std::string& name, int64_t, int64_t, bool, Linear& linear) override {
    const auto found = index.find(name);
    if (found == index.end()) return;
    linear.lora_A = A[found->second];
    linear.lora_B = B[found->second];
    linear.lora_rows = rows;
    linear.lora_scale = 1;
  }
  const std::vector<torch::Tensor>&A, &B;
  const bool rows;
  std::map<std::string, size_t> index;
};

struct AttachVisitor : ParameterVisitor {
  explicit AttachVisitor(const OpenpiLora& l) : lora(l) {}
  void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor&) override {}
  void OnLinear(const std::string& name, int64_t, int64_t, bool, Linear& linear) override {
    const auto found = lora.pairs.find(name);
    if (found == lora.pairs.end()) return;
    linear.lora_A = found->second.A;
    linear.lora_B = found->second.B;
    linear.lora_scale = lora.scale;
    ++attached;
  }
  const OpenpiLora& lora;
  size_t attached = 0;
};

// The stored halves of one adapter.
struct StoredPair {
  const TensorView* A = nullptr;
  const TensorView* B = nullptr;
};

std::map<std::string, StoredPair> CollectPairs(const SafetensorsFile& file,
                                               std::vector<std::string>& problems) {
  std::map<std::string, StoredPair> pairs;
  for (const auto& [name, view] : file.tensors()) {
    absl::string_view layer = name;
    if (!absl::ConsumePrefix(&layer, kRoot)) continue;
    if (absl::ConsumeSuffix(&layer, kA)) {
      pairs[std::string(layer)].A = &view;
    } else if (absl::ConsumeSuffix(&layer, kB)) {
      pairs[std::string(layer)].B = &view;
    } else {
      problems.push_back(absl::StrCat("unexpected: ", name, ", must end in ", kA, " or ", kB));
    }
  }
  return pairs;
}

// Why a stored pair does not fit its layer, or empty.
std::string PairProblem(const std::string& name, const StoredPair& pair,
                        const std::map<std::string, Sizes>& linears) {
  const auto layer = linears.find(name);
  if (layer == linears.end())
    return absl::StrCat("unexpected: ", kRoot, name, " is no linear layer of the network");
  if (pair.A == nullptr) return absl::StrCat("missing: ", kRoot, name, kA);
  if (pair.B == nullptr) return absl::StrCat("missing: ", kRoot, name, kB);
  const auto& a = pair.A->shape;
  const auto& b = pair.B->shape;
  if (a.size() == 2 && b.size() == 2 && a[1] == layer->second.in && b[0] == layer->second.out &&
      a[0] == b[1] && a[0] > 0) {
    return "";
  }
  return absl::StrCat("misshaped: ", kRoot, name, " has A ", ShapeText(a), " and B ", ShapeText(b),
                      ", must be [rank, ", layer->second.in, "] and [", layer->second.out,
                      ", rank]");
}

// A number in the metadata, `otherwise` when absent; not finite: a problem.
double MetadataNumber(const SafetensorsFile& file, const std::string& key, double otherwise,
                      std::vector<std::string>& problems) {
  const auto found = file.metadata().find(key);
  if (found == file.metadata().end()) return otherwise;
  double value = 0;
  if (!absl::SimpleAtod(found->second, &value) || !std::isfinite(value)) {
    problems.push_back(
        absl::StrCat("metadata '", key, "' is '", found->second, "', must be a finite number"));
  }
  return value;
}

}  // namespace

std::vector<LoraTarget> ExpertLoraTargets(const OpenpiConfig& c) {
  const int64_t w = c.expert_width, q = c.heads * c.head_dim, kv = c.kv_heads * c.head_dim;
  std::vector<LoraTarget> targets;
  for (int64_t i = 0; i < c.depth; ++i) {
    const std::string layer =
        absl::StrCat("paligemma_with_expert.gemma_expert.model.layers.", i, ".");
    targets.push_back({layer + "self_attn.q_proj", w, q, c.heads});
    targets.push_back({layer + "self_attn.k_proj", w, kv, c.kv_heads});
    targets.push_back({layer + "self_attn.v_proj", w, kv, c.kv_heads});
    targets.push_back({layer + "self_attn.o_proj", q, w, 1, c.heads});
    targets.push_back({layer + "mlp.gate_proj", w, c.expert_mlp});
    targets.push_back({layer + "mlp.up_proj", w, c.expert_mlp});
    targets.push_back({layer + "mlp.down_proj", c.expert_mlp, w});
  }
  return targets;
}

OpenpiModel WithLora(OpenpiModel model, const LoraWeights& lora) {
  TargetVisitor attach(model.config, lora.A, lora.B, false);
  VisitParameters(model.config, model.weights, attach);
  return model;
}

OpenpiModel WithLora(OpenpiModel model, const LoraRows& lora) {
  TargetVisitor attach(model.config, lora.A, lora.B, true);
  VisitParameters(model.config, model.weights, attach);
  return model;
}

absl::StatusOr<OpenpiLora> LoadOpenpiLora(const SafetensorsFile& file, const OpenpiConfig& config) {
  LinearCollector layers;
  OpenpiWeights nothing;
  VisitParameters(config, nothing, layers);
  std::vector<std::string> problems;
  const std::map<std::string, StoredPair> stored = CollectPairs(file, problems);
  if (stored.empty()) problems.push_back(absl::StrCat("missing: any tensor under ", kRoot));
  OpenpiLora lora;
  lora.scale = MetadataNumber(file, "scale", 1, problems);
  const double rank = MetadataNumber(file, "rank", 0, problems);
  for (const auto& [name, pair] : stored) {
    std::string problem = PairProblem(name, pair, layers.linears);
    if (problem.empty() && rank != 0 && static_cast<double>(pair.A->shape[0]) != rank) {
      problem = absl::StrCat("misshaped: ", kRoot, name, " has rank ", pair.A->shape[0],
                             ", metadata 'rank' says ", rank);
    }
    if (!problem.empty()) problems.push_back(std::move(problem));
  }
  RS_RETURN_IF_ERROR(ProblemList(file.path(), "not an adapter of this network", problems,
                                 "Give the adapter that was trained on these weights"));
  for (const auto& [name, pair] : stored) {
    const std::string what = absl::StrCat(file.path(), ": tensor '", kRoot, name);
    RS_ASSIGN_OR_RETURN(lora.pairs[name].A, ToFiniteFloats(absl::StrCat(what, kA, "'"), *pair.A));
    RS_ASSIGN_OR_RETURN(lora.pairs[name].B, ToFiniteFloats(absl::StrCat(what, kB, "'"), *pair.B));
  }
  return lora;
}

OpenpiModel WithLora(OpenpiModel model, const OpenpiLora& lora) {
  AttachVisitor attach(lora);
  VisitParameters(model.config, model.weights, attach);
  RS_CHECK(attach.attached == lora.pairs.size());
  return model;
}

}  // namespace robostress::openpi
