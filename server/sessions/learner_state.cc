#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/adaptation_state.h"
#include "adapter/lora.h"
#include "adapter/method_options.h"
#include "common/status_macros.h"
#include "server/sessions/learner.h"

// What a learner knows, as a value: export, import, versions.
namespace robostress {

AdaptationState Learner::State() const {
  const PolicySpec& policy = policy_->spec();
  AdaptationState state;
  state.policy = policy.name;
  state.model_hash = policy.model_hash;
  state.method = spec_->method->method;
  state.lora_kind = lora_.kind;
  state.session = SessionIdentity(*spec_);
  state.lora = adapter_->Export();
  state.triggers = triggers_;
  state.chunks_since_clear = schedule_.chunks();
  state.nominal_task = arm_episode_.task;
  state.nominal_episode = arm_episode_.episode;
  state.nominal = arm_.state();
  state.last_loss = last_loss_;
  return state;
}

std::vector<BufferedChunk> Learner::Buffer() const {
  std::vector<BufferedChunk> chunks;
  for (int i = 0; i < buffer_.size(); ++i) chunks.push_back(buffer_[i]);
  return chunks;
}

absl::StatusOr<AdaptationState> Learner::Read(const std::string& name,
                                              const std::string& safetensors) const {
  const PolicySpec& policy = policy_->spec();
  RS_ASSIGN_OR_RETURN(AdaptationState state,
                      ParseAdaptationState(name, safetensors, *policy_, policy.model_hash));
  if (state.method != spec_->method->method || state.policy != policy.name) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the adapter was learned by method ", state.method, " on policy ", state.policy,
        "; this session runs method ", spec_->method->method, " on policy ", policy.name));
  }
  if (adapts() && state.lora_kind != lora_.kind) {
    return absl::InvalidArgumentError(
        absl::StrCat("the adapter's parameters are ", LoraKindName(state.lora_kind),
                     "; this session's method has lora: ", LoraKindName(lora_.kind),
                     "; open the session with the adapter's kind"));
  }
  return state;
}

absl::Status Learner::CheckShapes(const AdaptationState& state) const {
  return adapter_->CheckShapes(state.lora);
}

absl::Status Learner::Apply(const AdaptationState& state) {
  RS_RETURN_IF_ERROR(adapter_->Import(state.lora));
  triggers_ = state.triggers;
  schedule_.set_chunks(state.chunks_since_clear);
  buffer_.Clear();
  for (const auto& chunk : state.buffer) {  // the file has no observations to rebuild from
    buffer_.Add({nullptr, prefixes_->Add(policy_, nullptr, chunk->context), chunk->target});
  }
  boundaries_.clear();
  arm_.set_state(state.nominal);
  arm_episode_ = {static_cast<int>(state.nominal_task), static_cast<int>(state.nominal_episode)};
  last_loss_ = state.last_loss;
  return absl::OkStatus();
}

absl::Status Learner::Restore(const std::vector<BufferedChunk>& buffer,
                              const std::vector<PublishedVersion>& versions,
                              const std::vector<uint64_t>& boundaries, const Counters& counters) {
  if (adapts()) RS_RETURN_IF_ERROR(adapter_->RestoreVersions(versions));
  for (const BufferedChunk& chunk : buffer) buffer_.Add(chunk);
  boundaries_.insert(boundaries.begin(), boundaries.end());
  counters_ = counters;
  return absl::OkStatus();
}

absl::Status Learner::Rollback(uint64_t version) {
  RS_RETURN_IF_ERROR(adapter_->Rollback(version));
  Clear();
  ++counters_.rollbacks;
  return absl::OkStatus();
}

absl::Status Learner::CheckPin(uint64_t version, bool pinned) const {
  return adapter_->CheckPin(version, pinned);
}

std::vector<PublishedVersion> Learner::Versions() const {
  return adapts() ? adapter_->Versions() : std::vector<PublishedVersion>();
}

}  // namespace robostress
