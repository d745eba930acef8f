#include "server/sessions/state_rules.h"

#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"
#include "server/sessions/session_snapshot.h"

namespace robostress {
namespace {

template <class... Parts>
absl::Status Invalid(const Parts&... parts) {
  return absl::InvalidArgumentError(absl::StrCat(parts...));
}

absl::Status CheckIndex(const char* field, int64_t value, int64_t low) {
  if (value >= low && value <= WireLimits::kIndex) return absl::OkStatus();
  return Invalid(field, " is ", value, ", must be ", low, " to ", WireLimits::kIndex);
}

// What an operator lets views be (--max-view-side) may differ from one start to the next.
PolicySpec AnySide(PolicySpec policy) {
  policy.max_view_side = WireLimits::kImageSide;
  return policy;
}

}  // namespace

absl::Status StateRules::CheckCount(const char* field, uint64_t value) {
  if (value <= kMaxCount) return absl::OkStatus();
  return Invalid(field, " is ", value, ", at most ", kMaxCount, " is possible");
}

absl::Status StateRules::CheckEpisode(int64_t task, int64_t episode, int64_t low) {
  RS_RETURN_IF_ERROR(CheckIndex("task", task, 0));
  return CheckIndex("episode", episode, low);
}

absl::Status StateRules::CheckKey(const ChunkKey& key) {
  RS_RETURN_IF_ERROR(CheckEpisode(key.episode.task, key.episode.episode));
  return CheckIndex("chunk", key.chunk, 0);
}

absl::Status StateRules::CheckChunk(const char* field, const torch::Tensor& tensor) const {
  if (!tensor.defined() || tensor.scalar_type() != torch::kFloat32 || tensor.dim() != 2 ||
      tensor.size(0) != policy_->horizon() || tensor.size(1) != policy_->model_action_dim()) {
    return Invalid(field, " is not [", policy_->horizon(), ", ", policy_->model_action_dim(),
                   "] float32");
  }
  if (torch::isfinite(tensor).all().item<bool>()) return absl::OkStatus();
  return Invalid(field, " holds a value that is not finite");
}

absl::Status StateRules::CheckSchedule(int64_t chunks_since_clear, size_t buffered) const {
  const LoraOptions& method = *spec_->method->Find<LoraOptions>();
  if (chunks_since_clear < 0) {
    return Invalid("chunks_since_clear is ", chunks_since_clear, ", must be 0 or above");
  }
  RS_RETURN_IF_ERROR(CheckCount("chunks_since_clear", static_cast<uint64_t>(chunks_since_clear)));
  const auto held = static_cast<int64_t>(buffered);
  if (held > method.buffer_chunks) {
    return Invalid("the buffer holds ", held, " chunks; this session's buffer_chunks is ",
                   method.buffer_chunks);
  }
  if (held > chunks_since_clear) {
    return Invalid("the buffer holds ", held, " chunks and chunks_since_clear is ",
                   chunks_since_clear, "; it cannot hold more than came");
  }
  // The chunk that triggers the next update (UpdateSchedule); later ones find more in the buffer.
  const int64_t late = std::max<int64_t>(0, chunks_since_clear + 1 - method.buffer_chunks);
  const int64_t interval = method.update_interval;
  const int64_t next = method.buffer_chunks + (late + interval - 1) / interval * interval;
  const int64_t then = std::min<int64_t>(method.buffer_chunks, held + (next - chunks_since_clear));
  if (then >= method.batch) return absl::OkStatus();
  return Invalid("the buffer holds ", held, " chunks after ", chunks_since_clear,
                 " and would hold ", then, " when the update at ", next,
                 " falls due; this session's batch is ", method.batch,
                 ": open it with a smaller batch");
}

absl::Status StateRules::CheckAdaptation(const AdaptationState& state, size_t buffered) const {
  RS_RETURN_IF_ERROR(CheckCount("feedback_sequence", state.feedback_sequence));
  // An update takes a chunk at least; an adapter from elsewhere begins as version 1 (peft.h).
  if (state.lora.phi.version > state.feedback_sequence + 1) {
    return Invalid("version is ", state.lora.phi.version, " at feedback_sequence ",
                   state.feedback_sequence, "; at most one more is possible");
  }
  const int64_t steps = state.lora.adam.steps;
  if (steps < 0 || static_cast<uint64_t>(steps) > state.lora.phi.version) {
    return Invalid("adam_steps is ", steps, ", must be 0 to the version, ", state.lora.phi.version);
  }
  RS_RETURN_IF_ERROR(CheckSchedule(state.chunks_since_clear, buffered));
  const auto chunks = static_cast<uint64_t>(state.chunks_since_clear);
  if (chunks > state.feedback_sequence || state.triggers > state.feedback_sequence) {
    return Invalid("chunks_since_clear is ", chunks, " and triggers ", state.triggers,
                   "; neither can be above feedback_sequence, ", state.feedback_sequence);
  }
  RS_RETURN_IF_ERROR(CheckIndex("task", state.task, -1));
  RS_RETURN_IF_ERROR(CheckIndex("nominal_task", state.nominal_task, -1));
  RS_RETURN_IF_ERROR(CheckIndex("nominal_episode", state.nominal_episode, -1));
  if (!NominalArm::Holds(state.nominal)) {
    return Invalid("nominal holds a value that is not a number of at most ", NominalArm::kMaxState);
  }
  if (!std::isfinite(state.last_loss))
    return Invalid("last_loss is ", state.last_loss, ", must be finite");
  // Squares, of which Adam takes the root.
  for (const torch::Tensor& v : state.lora.adam.v) {
    if (v.min().item<float>() < 0) return Invalid("adam_v holds a negative value");
  }
  return absl::OkStatus();
}

absl::Status StateRules::CheckPrediction(const Prediction& prediction) const {
  if (prediction.id == 0) return Invalid("a prediction has number 0; the first one has 1");
  RS_RETURN_IF_ERROR(CheckCount("prediction", prediction.id));
  const std::string where = absl::StrCat("prediction ", prediction.id);
  const auto within = [&where](const absl::Status& status) {
    return status.ok() ? status : Invalid(where, ": ", status.message());
  };
  RS_RETURN_IF_ERROR(within(CheckKey(prediction.key)));
  const bool adapts = spec_->method->adapts();
  if ((prediction.observation != nullptr) != adapts) {
    return Invalid(where, adapts ? " lacks its observation" : " has an observation", "; method ",
                   spec_->method->method, " adapts ", adapts ? "from it" : "nothing");
  }
  if (prediction.answered != nullptr)
    RS_RETURN_IF_ERROR(within(robostress::CheckPrediction(*prediction.answered, policy_->spec())));
  if (prediction.observation == nullptr) return absl::OkStatus();
  RS_RETURN_IF_ERROR(within(CheckObservation(*prediction.observation, AnySide(policy_->spec()))));
  RS_RETURN_IF_ERROR(within(CheckChunk("raw", prediction.raw)));
  const torch::Tensor& state = prediction.state;
  const int64_t state_dim = policy_->context_shape().state_dim;
  if (!state.defined() || state.scalar_type() != torch::kFloat32 || state.dim() != 2 ||
      state.size(0) != 1 || state.size(1) != state_dim) {
    return Invalid(where, ": state is not [1, ", state_dim, "] float32");
  }
  if (!torch::isfinite(state).all().item<bool>())
    return Invalid(where, ": state holds a value that is not finite");
  if (NeedsBase(spec_->method->target)) {
    const PolicySpec& policy = policy_->spec();
    return within(CheckMatrixSize("base", prediction.base, policy.horizon, policy.action_dim));
  }
  if (prediction.base.size() == 0) return absl::OkStatus();
  return Invalid(where, " has base actions; only targets intent and nominal_intent keep them");
}

absl::Status StateRules::CheckBuffered(const torch::Tensor& target, const Observation* observation,
                                       const PolicyContext& context) const {
  RS_RETURN_IF_ERROR(CheckChunk("target", target));
  if (observation != nullptr) return CheckObservation(*observation, AnySide(policy_->spec()));
  return CheckContext("a buffered chunk", context, policy_->context_shape());
}

absl::Status StateRules::CheckSnapshot(const SessionSnapshot& snapshot,
                                       size_t max_outstanding) const {
  RS_RETURN_IF_ERROR(CheckCount("feedback_sequence", snapshot.feedback_sequence));
  RS_RETURN_IF_ERROR(CheckCount("next_prediction", snapshot.next_prediction));
  if (snapshot.next_prediction == 0)
    return Invalid("next_prediction is 0; the first one has number 1");
  if (snapshot.episode_started)
    RS_RETURN_IF_ERROR(CheckEpisode(snapshot.task, snapshot.episode, -1));
  RS_RETURN_IF_ERROR(CheckIndex("next_chunk", snapshot.next_chunk.value_or(0), 0));
  if (snapshot.boundaries.size() > kMaxBoundaries) {
    return Invalid(snapshot.boundaries.size(), " boundaries wait for feedback, at most ",
                   kMaxBoundaries, " can");
  }
  for (const uint64_t boundary : snapshot.boundaries) {
    RS_RETURN_IF_ERROR(CheckCount("boundaries", boundary));
    if (boundary <= snapshot.feedback_sequence)
      return Invalid("a boundary waits for feedback ", boundary, ", which is in");
  }
  const auto found = snapshot.correction.find(DirectOptions::kWay.name);
  const Eigen::Index direct = found == snapshot.correction.end() ? 0 : found->second.size();
  if (direct != 0 && direct != policy_->spec().action_dim) {
    return Invalid("direct_correction has ", direct, " values, must have ",
                   policy_->spec().action_dim, " or none");
  }
  if (snapshot.outstanding.size() > max_outstanding) {
    return Invalid(snapshot.outstanding.size(), " predictions wait for feedback, at most ",
                   max_outstanding, " can");
  }
  uint64_t last = 0;
  for (const Prediction& prediction : snapshot.outstanding) {
    RS_RETURN_IF_ERROR(CheckPrediction(prediction));
    if (prediction.id <= last || prediction.id >= snapshot.next_prediction) {
      return Invalid("prediction ", prediction.id, " comes after ", last, ", and the next is ",
                     snapshot.next_prediction);
    }
    last = prediction.id;
  }
  if (snapshot.adaptation.has_value() != spec_->method->adapts()) {
    return Invalid("an adapter ", snapshot.adaptation ? "where method " : "is missing; method ",
                   spec_->method->method, spec_->method->adapts() ? " has one" : " has none");
  }
  if (!snapshot.adaptation) {
    if (snapshot.buffer.empty() && snapshot.versions.empty()) return absl::OkStatus();
    return Invalid("buffered chunks or versions where method ", spec_->method->method, " has none");
  }
  if (!snapshot.adaptation->buffer.empty())
    return Invalid("the adapter of a snapshot has a buffer of its own");
  if (snapshot.adaptation->feedback_sequence != snapshot.feedback_sequence) {
    return Invalid("the adapter stands at feedback ", snapshot.adaptation->feedback_sequence,
                   ", the session at ", snapshot.feedback_sequence);
  }
  for (const PublishedVersion& version : snapshot.versions) {
    if (version.feedback_sequence > snapshot.feedback_sequence) {
      return Invalid("version ", version.weights->version, " was made after feedback ",
                     version.feedback_sequence, "; the session stands at ",
                     snapshot.feedback_sequence);
    }
  }
  return CheckAdaptation(*snapshot.adaptation, snapshot.buffer.size());
}

}  // namespace robostress
