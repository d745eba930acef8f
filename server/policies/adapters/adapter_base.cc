#include "server/policies/adapters/adapter_base.h"

#include <torch/types.h>

#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "server/policies/checkpoint_policies.h"
#include "server/policies/nano/nano_network.h"
#include "server/policies/nano/nano_weights.h"
#include "server/policies/tensor_io.h"

namespace robostress {
namespace {

// q, k, v share a matrix, and so do gate and up; rows in that order.
WeightRows NanoRows(const NanoConfig& config, const std::string& target) {
  absl::string_view layer = target;
  const std::string root = "expert.";
  const int64_t q = config.heads * config.head_dim;
  if (absl::ConsumeSuffix(&layer, "q_proj"))
    return {absl::StrCat(root, layer, "qkv_proj.weight"), 0};
  if (absl::ConsumeSuffix(&layer, "k_proj"))
    return {absl::StrCat(root, layer, "qkv_proj.weight"), q};
  if (absl::ConsumeSuffix(&layer, "v_proj"))
    return {absl::StrCat(root, layer, "qkv_proj.weight"), q + config.head_dim};
  if (absl::ConsumeSuffix(&layer, "gate_proj"))
    return {absl::StrCat(root, layer, "gate_up_proj.weight"), 0};
  if (absl::ConsumeSuffix(&layer, "up_proj"))
    return {absl::StrCat(root, layer, "gate_up_proj.weight"), config.expert_mlp};
  return {absl::StrCat(root, layer, ".weight"), 0};
}

bool IsNano(const SafetensorsFile& file) {
  const auto format = file.metadata().find("format");
  return format != file.metadata().end() && format->second == kNanoFormat;
}

torch::ScalarType TypeOf(DType dtype) {
  return dtype == DType::kBF16  ? torch::kBFloat16
         : dtype == DType::kF16 ? torch::kFloat16
                                : torch::kFloat32;
}

}  // namespace

absl::StatusOr<AdapterBase> OpenAdapterBase(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  AdapterBase base;
  base.path = path;
  if (IsNano(file)) {
    RS_ASSIGN_OR_RETURN(const NanoModel model, LoadNanoModel(path));
    base.module_root = "expert.";
    RS_ASSIGN_OR_RETURN(base.model_hash, Sha256OfFile(path));
    base.targets = NanoLoraTargets(model.config);
    for (const LoraTarget& target : base.targets)
      base.weights.push_back(NanoRows(model.config, target.name));
  } else {
    RS_RETURN_IF_ERROR(OpenCheckpointBase(path, base));
  }
  return base;
}

absl::Status WriteMerged(const AdapterBase& base, const LoraWeights& lora,
                         const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(base.path));
  std::map<std::string, torch::Tensor> merged;  // float32
  for (size_t i = 0; i < base.targets.size(); ++i) {
    const LoraTarget& target = base.targets[i];
    const auto& [name, first_row] = base.weights[i];
    if (!merged.contains(name)) {
      RS_ASSIGN_OR_RETURN(const TensorView view, file.Get(name));
      RS_ASSIGN_OR_RETURN(merged[name],
                          openpi::ToFiniteFloats(absl::StrCat(base.path, ": ", name), view));
    }
    torch::Tensor& weight = merged[name];
    if (weight.dim() != 2 || weight.size(1) != target.in_features ||
        weight.size(0) < first_row + target.out_features) {
      return absl::InvalidArgumentError(absl::StrCat(base.path, ": ", name, " is ",
                                                     openpi::ShapeText(weight.sizes()),
                                                     ", too small for ", target.name));
    }
    const MatrixPair pair = AsMatrices(target, lora.A[i], lora.B[i]);
    weight.narrow(0, first_row, target.out_features).add_(torch::matmul(pair.B, pair.A));
  }
  SafetensorsWriter writer;
  for (const auto& [key, value] : file.metadata()) writer.SetMetadata(key, value);
  for (const auto& [name, view] : file.tensors()) {
    const auto found = merged.find(name);
    if (found == merged.end()) {
      writer.Add(name, view.dtype, view.shape, view.bytes.data(), view.bytes.size());
      continue;
    }
    const torch::Tensor stored = found->second.to(TypeOf(view.dtype)).contiguous();
    writer.Add(name, view.dtype, view.shape, stored.data_ptr(), stored.nbytes());
  }
  return writer.Write(path);
}

}  // namespace robostress
