#include "server/sessions/journal/state_records.h"

#include <torch/types.h>

#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/lora.h"
#include "common/rollout/message_limits.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr torch::ScalarType kTypes[] = {torch::kFloat32, torch::kFloat64, torch::kFloat16,
                                        torch::kBFloat16, torch::kBool};
constexpr int kMaxDimensions = 8;

template <class... Parts>
absl::Status Damaged(const Parts&... parts) {
  return absl::DataLossError(absl::StrCat("state on disk: ", parts...));
}

absl::Status Damaged(const absl::Status& status) { return Damaged(status.message()); }

absl::StatusOr<PolicyContext> ReadContext(const v1::StateContext& record) {
  PolicyContext context;
  for (const v1::StateTensor& tensor : record.keys()) {
    RS_ASSIGN_OR_RETURN(context.keys.emplace_back(), FromRecord("keys", tensor));
  }
  for (const v1::StateTensor& tensor : record.values()) {
    RS_ASSIGN_OR_RETURN(context.values.emplace_back(), FromRecord("values", tensor));
  }
  RS_ASSIGN_OR_RETURN(context.prefix_mask, FromRecord("prefix_mask", record.prefix_mask()));
  RS_ASSIGN_OR_RETURN(context.state, FromRecord("state", record.state()));
  return context;
}

absl::StatusOr<std::shared_ptr<const Observation>> ReadObservation(const v1::Observation& record) {
  absl::StatusOr<Observation> observation = FromProto(record);
  if (!observation.ok()) return Damaged(observation.status());
  return std::make_shared<const Observation>(*std::move(observation));
}

absl::StatusOr<std::shared_ptr<const PredictedChunk>> ReadAnswered(
    const v1::StatePrediction& record) {
  auto answered = std::make_shared<PredictedChunk>();
  answered->prediction_id = record.id();
  answered->adapter_version = record.adapter_version();
  const auto read = [](const char* field, const v1::FloatMatrix& from,
                       Eigen::MatrixXf& into) -> absl::Status {
    absl::StatusOr<Eigen::MatrixXf> matrix = FromProto(field, from);
    if (!matrix.ok()) return Damaged(matrix.status());
    into = *std::move(matrix);
    return absl::OkStatus();
  };
  RS_RETURN_IF_ERROR(read("actions", record.actions(), answered->actions));
  answered->policy_actions = answered->actions;
  if (record.has_policy_actions())
    RS_RETURN_IF_ERROR(read("policy_actions", record.policy_actions(), answered->policy_actions));
  if (record.has_base_actions())
    RS_RETURN_IF_ERROR(read("base_actions", record.base_actions(), answered->base_actions));
  for (const Eigen::MatrixXf* rows : {&answered->policy_actions, &answered->base_actions}) {
    if (rows->size() > 0 &&
        (rows->rows() != answered->actions.rows() || rows->cols() != answered->actions.cols()))
      return Damaged("prediction ", record.id(), " holds actions of two sizes");
  }
  return answered;
}

}  // namespace

v1::StateTensor ToRecord(const torch::Tensor& tensor) {
  v1::StateTensor record;
  const torch::Tensor dense = tensor.detach().cpu().contiguous();
  for (uint32_t type = 0; type < std::size(kTypes); ++type) {
    if (kTypes[type] == dense.scalar_type()) record.set_type(type);
  }
  for (const int64_t size : dense.sizes()) record.add_shape(size);
  record.set_data(dense.data_ptr(), dense.nbytes());
  return record;
}

absl::StatusOr<torch::Tensor> FromRecord(const char* field, const v1::StateTensor& record) {
  if (record.type() >= std::size(kTypes))
    return Damaged(field, " has type ", record.type(), ", which no state uses");
  if (record.shape_size() > kMaxDimensions)
    return Damaged(field, " has ", record.shape_size(), " dimensions");
  const torch::ScalarType type = kTypes[record.type()];
  uint64_t bytes = c10::elementSize(type);
  for (const int64_t size : record.shape()) {
    if (size < 1 || size > (int64_t{1} << 31)) return Damaged(field, " has a size of ", size);
    bytes *= static_cast<uint64_t>(size);
    if (bytes > (uint64_t{1} << 31)) return Damaged(field, " is larger than 2 GiB");
  }
  if (bytes != record.data().size()) {
    return Damaged(field, " has ", record.data().size(), " bytes, its shape needs ", bytes);
  }
  torch::Tensor tensor =
      torch::empty(std::vector<int64_t>(record.shape().begin(), record.shape().end()), type);
  std::memcpy(tensor.data_ptr(), record.data().data(), bytes);
  if (tensor.is_floating_point() && !torch::isfinite(tensor).all().item<bool>())
    return Damaged(field, " holds a value that is not finite");
  return tensor;
}

v1::UpdateGuard ToRecord(const GuardOptions& guard) {
  v1::UpdateGuard record;
  record.set_enabled(guard.enabled);
  record.set_max_loss_ratio(guard.max_loss_ratio);
  record.set_max_distance(guard.max_distance);
  record.set_draws(static_cast<uint32_t>(guard.draws));
  record.set_chunks(static_cast<uint32_t>(guard.chunks));
  return record;
}

absl::StatusOr<GuardOptions> FromRecord(const v1::UpdateGuard& record) {
  GuardOptions guard;
  guard.enabled = record.enabled();
  const auto invalid = [](const char* field, const auto& value, const char* limits) {
    return absl::InvalidArgumentError(
        absl::StrCat("guard.", field, " is ", value, ", must be ", limits));
  };
  if (record.max_loss_ratio() != 0) guard.max_loss_ratio = record.max_loss_ratio();
  if (!(guard.max_loss_ratio > 0 && guard.max_loss_ratio <= 1e6))
    return invalid("max_loss_ratio", guard.max_loss_ratio, "above 0, at most 1e6");
  if (!(record.max_distance() >= 0 && record.max_distance() <= 1e12))
    return invalid("max_distance", record.max_distance(), "0 (no bound) to 1e12");
  guard.max_distance = record.max_distance();
  if (record.draws() > 64) return invalid("draws", record.draws(), "at most 64");
  if (record.chunks() > 64) return invalid("chunks", record.chunks(), "at most 64");
  if (record.draws() != 0) guard.draws = static_cast<int>(record.draws());
  if (record.chunks() != 0) guard.chunks = static_cast<int>(record.chunks());
  return guard;
}

v1::StatePrediction ToRecord(const Prediction& prediction, bool with_views) {
  v1::StatePrediction record;
  record.set_id(prediction.id);
  record.set_task(static_cast<uint32_t>(prediction.key.episode.task));
  record.set_episode(static_cast<uint32_t>(prediction.key.episode.episode));
  record.set_chunk(static_cast<uint32_t>(prediction.key.chunk));
  // A matrix that is not finite could not be read again: then the chunk is not kept.
  const PredictedChunk* answered = prediction.answered.get();
  if (answered != nullptr && answered->actions.allFinite() &&
      answered->policy_actions.allFinite() && answered->base_actions.allFinite()) {
    *record.mutable_actions() = ToProto(answered->actions);
    if (answered->policy_actions != answered->actions)
      *record.mutable_policy_actions() = ToProto(answered->policy_actions);
    if (answered->base_actions.rows() > 0)
      *record.mutable_base_actions() = ToProto(answered->base_actions);
    record.set_adapter_version(answered->adapter_version);
  }
  if (prediction.observation == nullptr) return record;
  *record.mutable_raw() = ToRecord(prediction.raw);
  *record.mutable_state() = ToRecord(prediction.state);
  if (with_views) {
    *record.mutable_observation() = ToProto(*prediction.observation);
  } else {
    const Observation& seen = *prediction.observation;
    *record.mutable_observation() = ToProto(Observation{seen.instruction, {}, seen.proprioception});
  }
  if (prediction.base.rows() > 0) *record.mutable_base() = ToProto(prediction.base);
  return record;
}

absl::StatusOr<Prediction> FromRecord(const v1::StatePrediction& record) {
  Prediction prediction;
  prediction.id = record.id();
  constexpr auto kLimit = static_cast<uint32_t>(WireLimits::kIndex);
  if (record.task() > kLimit || record.episode() > kLimit || record.chunk() > kLimit)
    return Damaged("prediction ", record.id(), " is of a task, episode or chunk above ", kLimit);
  prediction.key = {{static_cast<int>(record.task()), static_cast<int>(record.episode())},
                    static_cast<int>(record.chunk())};
  prediction.journaled = true;
  if (record.has_actions()) {
    RS_ASSIGN_OR_RETURN(prediction.answered, ReadAnswered(record));
  }
  if (!record.has_observation()) return prediction;
  RS_ASSIGN_OR_RETURN(prediction.raw, FromRecord("raw", record.raw()));
  RS_ASSIGN_OR_RETURN(prediction.state, FromRecord("state", record.state()));
  RS_ASSIGN_OR_RETURN(prediction.observation, ReadObservation(record.observation()));
  if (record.has_base()) {
    absl::StatusOr<Eigen::MatrixXf> base = FromProto("base", record.base());
    if (!base.ok()) return Damaged(base.status());
    prediction.base = *std::move(base);
  }
  return prediction;
}

v1::StateTrainingChunk ToRecord(const BufferedChunk& chunk, const PolicyContext* context) {
  v1::StateTrainingChunk record;
  *record.mutable_target() = ToRecord(chunk.target);
  if (context == nullptr) {
    *record.mutable_observation() = ToProto(*chunk.observation);
    return record;
  }
  v1::StateContext& out = *record.mutable_context();
  for (const torch::Tensor& tensor : context->keys) *out.add_keys() = ToRecord(tensor);
  for (const torch::Tensor& tensor : context->values) *out.add_values() = ToRecord(tensor);
  *out.mutable_prefix_mask() = ToRecord(context->prefix_mask);
  *out.mutable_state() = ToRecord(context->state);
  return record;
}

absl::StatusOr<StoredChunk> FromRecord(const v1::StateTrainingChunk& record) {
  StoredChunk chunk;
  RS_ASSIGN_OR_RETURN(chunk.target, FromRecord("target", record.target()));
  if (record.has_observation()) {
    RS_ASSIGN_OR_RETURN(chunk.observation, ReadObservation(record.observation()));
  } else if (record.has_context()) {
    RS_ASSIGN_OR_RETURN(chunk.context, ReadContext(record.context()));
  } else {
    return Damaged("a buffered chunk has neither an observation nor a prefix");
  }
  return chunk;
}

v1::StateVersion ToRecord(const PublishedVersion& version) {
  v1::StateVersion record;
  record.set_version(version.weights->version);
  record.set_pinned(version.pinned);
  record.set_distance(version.distance);
  record.set_feedback_sequence(version.feedback_sequence);
  record.set_loss(version.loss);
  for (const torch::Tensor& tensor : Parameters(*version.weights))
    *record.add_parameters() = ToRecord(tensor);
  return record;
}

absl::StatusOr<PublishedVersion> FromRecord(const v1::StateVersion& record) {
  std::vector<torch::Tensor> parameters;
  for (const v1::StateTensor& tensor : record.parameters()) {
    RS_ASSIGN_OR_RETURN(parameters.emplace_back(), FromRecord("version", tensor));
  }
  if (parameters.size() % 2 != 0) return Damaged("version ", record.version(), " lacks a tensor");
  return PublishedVersion{
      std::make_shared<const LoraWeights>(FromParameters(parameters, record.version())),
      record.distance(), record.loss(), record.feedback_sequence(), record.pinned()};
}

}  // namespace robostress
