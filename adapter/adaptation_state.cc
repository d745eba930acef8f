#include "adapter/adaptation_state.h"

#include <torch/types.h>

#include <cstring>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr char kFormat[] = "robostress-adapter-1";

struct TypePair {
  DType file;
  torch::ScalarType torch;
};
constexpr TypePair kTypes[] = {{DType::kF32, torch::kFloat32}, {DType::kF64, torch::kFloat64},
                               {DType::kF16, torch::kFloat16}, {DType::kBF16, torch::kBFloat16},
                               {DType::kBool, torch::kBool},   {DType::kI64, torch::kInt64}};

void AddTensor(SafetensorsWriter& writer, const std::string& name, const torch::Tensor& tensor) {
  const torch::Tensor dense = tensor.detach().cpu().contiguous();
  for (const TypePair& type : kTypes) {
    if (type.torch != dense.scalar_type()) continue;
    writer.Add(name, type.file, dense.sizes().vec(), dense.data_ptr(), dense.nbytes());
  }
}

// A tensor of this shape (-1: any extent of at least 1) and type. LibTorch sees no shape that was
// not checked: it throws, or overflows, at those of a damaged file.
absl::StatusOr<torch::Tensor> ReadShaped(const SafetensorsFile& file, const std::string& name,
                                         const std::vector<int64_t>& shape,
                                         torch::ScalarType type) {
  RS_ASSIGN_OR_RETURN(const TensorView view, file.Get(name));
  bool fits = view.shape.size() == shape.size();
  for (size_t i = 0; fits && i < shape.size(); ++i)
    fits = shape[i] < 0 ? view.shape[i] > 0 : view.shape[i] == shape[i];
  fits = fits && absl::c_any_of(kTypes, [&](const TypePair& pair) {
           return pair.torch == type && pair.file == view.dtype;
         });
  if (!fits) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.path(), ": ", name, " is ", DTypeName(view.dtype), " [",
                     absl::StrJoin(view.shape, ", "), "]; expected ", torch::toString(type), " [",
                     absl::StrJoin(shape, ", "), "]"));
  }
  torch::Tensor tensor = torch::empty(view.shape, type);
  std::memcpy(tensor.data_ptr(), view.bytes.data(), tensor.nbytes());
  if (tensor.is_floating_point() && !torch::isfinite(tensor).all().item<bool>()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.path(), ": ", name, " holds a value that is not finite"));
  }
  return tensor;
}

absl::StatusOr<std::string> Text(const SafetensorsFile& file, const std::string& key) {
  const auto found = file.metadata().find(key);
  if (found == file.metadata().end()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.path(), ": metadata has no '", key, "'; not an adapter state"));
  }
  return found->second;
}

template <class Int>
absl::Status ReadInt(const SafetensorsFile& file, const std::string& key, Int& value) {
  RS_ASSIGN_OR_RETURN(const std::string text, Text(file, key));
  if (!absl::SimpleAtoi(text, &value)) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.path(), ": metadata '", key, "' is '", text, "', not a number"));
  }
  return absl::OkStatus();
}

// Files from before there were two kinds do not say theirs: they are per_matrix.
absl::StatusOr<LoraKind> ReadLoraKind(const SafetensorsFile& file) {
  const auto found = file.metadata().find("lora");
  if (found == file.metadata().end()) return LoraKind::kPerMatrix;
  for (const LoraKind kind : {LoraKind::kPerHead, LoraKind::kPerMatrix}) {
    if (found->second == LoraKindName(kind)) return kind;
  }
  return absl::InvalidArgumentError(absl::StrCat(
      file.path(), ": metadata 'lora' is '", found->second, "', must be per_head or per_matrix"));
}

// A_i and B_i of one role ("phi", "phi_0", "adam_m", "adam_v") in the order of Parameters().
absl::StatusOr<std::vector<torch::Tensor>> ReadRole(const SafetensorsFile& file,
                                                    const std::string& role,
                                                    const std::vector<LoraTarget>& targets,
                                                    LoraKind kind) {
  std::vector<torch::Tensor> result;
  for (const LoraTarget& target : targets) {
    RS_ASSIGN_OR_RETURN(torch::Tensor A,
                        ReadShaped(file, absl::StrCat(role, ".", target.name, ".A"),
                                   LoraShapeOf(target, kind, -1).A, torch::kFloat32));
    RS_ASSIGN_OR_RETURN(torch::Tensor B,
                        ReadShaped(file, absl::StrCat(role, ".", target.name, ".B"),
                                   LoraShapeOf(target, kind, A.size(-2)).B, torch::kFloat32));
    result.push_back(std::move(A));
    result.push_back(std::move(B));
  }
  return result;
}

void AddRole(SafetensorsWriter& writer, const std::string& role,
             const std::vector<LoraTarget>& targets, const std::vector<torch::Tensor>& parameters) {
  for (size_t i = 0; i < targets.size(); ++i) {
    AddTensor(writer, absl::StrCat(role, ".", targets[i].name, ".A"), parameters[2 * i]);
    AddTensor(writer, absl::StrCat(role, ".", targets[i].name, ".B"), parameters[2 * i + 1]);
  }
}

absl::StatusOr<std::shared_ptr<const TrainingChunk>> ReadChunk(const SafetensorsFile& file,
                                                               const std::string& prefix,
                                                               const VelocityField& field) {
  const ContextShape shape = field.context_shape();
  auto chunk = std::make_shared<TrainingChunk>();
  RS_ASSIGN_OR_RETURN(chunk->target,
                      ReadShaped(file, prefix + "target",
                                 {field.horizon(), field.model_action_dim()}, torch::kFloat32));
  RS_ASSIGN_OR_RETURN(chunk->context.prefix_mask,
                      ReadShaped(file, prefix + "prefix_mask", {1, -1}, torch::kBool));
  RS_ASSIGN_OR_RETURN(chunk->context.state,
                      ReadShaped(file, prefix + "state", {1, shape.state_dim}, torch::kFloat32));
  const std::vector<int64_t> of_layer{1, shape.kv_heads, chunk->context.prefix_mask.size(1),
                                      shape.head_dim};
  for (int64_t layer = 0; layer < shape.layers; ++layer) {
    for (auto* side : {&chunk->context.keys, &chunk->context.values}) {
      const std::string name =
          absl::StrCat(prefix, side == &chunk->context.keys ? "keys." : "values.", layer);
      RS_ASSIGN_OR_RETURN(side->emplace_back(), ReadShaped(file, name, of_layer, shape.kv_type));
    }
  }
  RS_RETURN_IF_ERROR(CheckContext(
      absl::StrCat(file.path(), ": ", prefix.substr(0, prefix.size() - 1)), chunk->context, shape));
  return std::shared_ptr<const TrainingChunk>(std::move(chunk));
}

}  // namespace

absl::StatusOr<std::string> SerializeAdaptationState(const AdaptationState& state,
                                                     const std::vector<LoraTarget>& targets) {
  SafetensorsWriter writer;
  writer.SetMetadata("format", kFormat);
  writer.SetMetadata("policy", state.policy);
  writer.SetMetadata("model_hash", state.model_hash);
  writer.SetMetadata("method", state.method);
  writer.SetMetadata("lora", LoraKindName(state.lora_kind));
  writer.SetMetadata("session", state.session);
  writer.SetMetadata("version", absl::StrCat(state.lora.phi.version));
  writer.SetMetadata("adam_steps", absl::StrCat(state.lora.adam.steps));
  writer.SetMetadata("triggers", absl::StrCat(state.triggers));
  writer.SetMetadata("feedback_sequence", absl::StrCat(state.feedback_sequence));
  writer.SetMetadata("chunks_since_clear", absl::StrCat(state.chunks_since_clear));
  writer.SetMetadata("task", absl::StrCat(state.task));
  writer.SetMetadata("nominal_task", absl::StrCat(state.nominal_task));
  writer.SetMetadata("nominal_episode", absl::StrCat(state.nominal_episode));
  writer.SetMetadata("buffered", absl::StrCat(state.buffer.size()));
  writer.SetMetadata("layers",
                     absl::StrCat(state.buffer.empty() ? 0 : state.buffer[0]->context.keys.size()));

  AddRole(writer, "phi", targets, Parameters(state.lora.phi));
  AddRole(writer, "phi_0", targets, Parameters(state.lora.phi_0));
  AddRole(writer, "adam_m", targets, state.lora.adam.m);
  AddRole(writer, "adam_v", targets, state.lora.adam.v);
  std::vector<double> nominal(state.nominal.goal.data(), state.nominal.goal.data() + 6);
  nominal.insert(nominal.end(), state.nominal.velocity.data(), state.nominal.velocity.data() + 6);
  writer.AddDoubles("nominal", {2, 6}, nominal);
  writer.AddDoubles("last_loss", {1}, {state.last_loss});
  for (size_t i = 0; i < state.buffer.size(); ++i) {
    const std::string prefix = absl::StrFormat("buffer.%03d.", i);
    const TrainingChunk& chunk = *state.buffer[i];
    AddTensor(writer, prefix + "target", chunk.target);
    AddTensor(writer, prefix + "prefix_mask", chunk.context.prefix_mask);
    AddTensor(writer, prefix + "state", chunk.context.state);
    for (size_t layer = 0; layer < chunk.context.keys.size(); ++layer) {
      AddTensor(writer, absl::StrCat(prefix, "keys.", layer), chunk.context.keys[layer]);
      AddTensor(writer, absl::StrCat(prefix, "values.", layer), chunk.context.values[layer]);
    }
  }
  return writer.Serialize();
}

namespace {

absl::StatusOr<AdaptationState> ReadWithoutBuffer(const SafetensorsFile& file,
                                                  const std::vector<LoraTarget>& targets,
                                                  const std::string& model_hash) {
  const std::string& name = file.path();
  RS_ASSIGN_OR_RETURN(const std::string format, Text(file, "format"));
  if (format != kFormat) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": format is '", format, "'; this program reads '", kFormat, "'"));
  }
  AdaptationState state;
  RS_ASSIGN_OR_RETURN(state.policy, Text(file, "policy"));
  RS_ASSIGN_OR_RETURN(state.model_hash, Text(file, "model_hash"));
  RS_ASSIGN_OR_RETURN(state.method, Text(file, "method"));
  RS_ASSIGN_OR_RETURN(state.session, Text(file, "session"));
  RS_ASSIGN_OR_RETURN(state.lora_kind, ReadLoraKind(file));
  if (!model_hash.empty() && state.model_hash != model_hash) {
    return absl::InvalidArgumentError(absl::StrCat(
        name, ": the adapter belongs to weights ", state.model_hash, "; this policy has ",
        model_hash, "; an adapter is of use only with the weights it was learned on"));
  }
  RS_RETURN_IF_ERROR(ReadInt(file, "version", state.lora.phi.version));
  RS_RETURN_IF_ERROR(ReadInt(file, "adam_steps", state.lora.adam.steps));
  RS_RETURN_IF_ERROR(ReadInt(file, "triggers", state.triggers));
  RS_RETURN_IF_ERROR(ReadInt(file, "feedback_sequence", state.feedback_sequence));
  RS_RETURN_IF_ERROR(ReadInt(file, "chunks_since_clear", state.chunks_since_clear));
  RS_RETURN_IF_ERROR(ReadInt(file, "task", state.task));
  RS_RETURN_IF_ERROR(ReadInt(file, "nominal_task", state.nominal_task));
  RS_RETURN_IF_ERROR(ReadInt(file, "nominal_episode", state.nominal_episode));
  const uint64_t version = state.lora.phi.version;
  RS_ASSIGN_OR_RETURN(const auto phi, ReadRole(file, "phi", targets, state.lora_kind));
  RS_ASSIGN_OR_RETURN(const auto phi_0, ReadRole(file, "phi_0", targets, state.lora_kind));
  state.lora.phi = FromParameters(phi, version);
  state.lora.phi_0 = FromParameters(phi_0, 0);
  RS_ASSIGN_OR_RETURN(state.lora.adam.m, ReadRole(file, "adam_m", targets, state.lora_kind));
  RS_ASSIGN_OR_RETURN(state.lora.adam.v, ReadRole(file, "adam_v", targets, state.lora_kind));
  RS_ASSIGN_OR_RETURN(const std::vector<double> nominal, file.ReadDoubles("nominal", {2, 6}));
  state.nominal.goal = Eigen::Map<const NominalArm::Vector6>(nominal.data());
  state.nominal.velocity = Eigen::Map<const NominalArm::Vector6>(nominal.data() + 6);
  RS_ASSIGN_OR_RETURN(const std::vector<double> last_loss, file.ReadDoubles("last_loss", {1}));
  state.last_loss = last_loss[0];
  return state;
}

}  // namespace

absl::StatusOr<AdaptationState> ParseAdapter(const std::string& name, std::string bytes,
                                             const std::vector<LoraTarget>& targets,
                                             const std::string& model_hash) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Parse(name, std::move(bytes)));
  return ReadWithoutBuffer(file, targets, model_hash);
}

absl::StatusOr<AdaptationState> ParseAdaptationState(const std::string& name, std::string bytes,
                                                     const VelocityField& field,
                                                     const std::string& model_hash) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Parse(name, std::move(bytes)));
  RS_ASSIGN_OR_RETURN(AdaptationState state,
                      ReadWithoutBuffer(file, field.lora_targets(), model_hash));
  int layers = 0, buffered = 0;
  RS_RETURN_IF_ERROR(ReadInt(file, "buffered", buffered));
  RS_RETURN_IF_ERROR(ReadInt(file, "layers", layers));
  if (buffered < 0 || static_cast<size_t>(buffered) > file.tensors().size()) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": metadata says ", buffered, " buffered chunks; the file is damaged"));
  }
  if (buffered > 0 && layers != field.context_shape().layers) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": its buffered chunks have keys and values of ", layers,
                     " layers; this policy has ", field.context_shape().layers));
  }
  for (int i = 0; i < buffered; ++i) {
    RS_ASSIGN_OR_RETURN(auto chunk, ReadChunk(file, absl::StrFormat("buffer.%03d.", i), field));
    state.buffer.push_back(std::move(chunk));
  }
  return state;
}

}  // namespace robostress
