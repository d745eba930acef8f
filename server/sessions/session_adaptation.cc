#include <torch/types.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/adam.h"
#include "adapter/adaptation_state.h"
#include "adapter/lora.h"
#include "adapter/method_options.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/inference/without_exceptions.h"
#include "server/sessions/session.h"

// A session's adaptation as a value: export, import, versions.
namespace robostress {

AdaptationState Session::CurrentAdaptation() {
  AdaptationState state;
  state.policy = policy_spec().name;
  state.model_hash = policy_spec().model_hash;
  state.method = spec_.method->method;
  state.lora_kind = spec_.method->Find<LoraOptions>()->kind;
  state.session = SessionIdentity(spec_);
  state.lora = adapter_->Export();
  state.triggers = triggers_;
  state.feedback_sequence = feedback_sequence_;
  state.chunks_since_clear = schedule_.chunks();
  state.task = episode_ ? episode_->first : -1;
  state.nominal_task = arm_episode_.first;
  state.nominal_episode = arm_episode_.second;
  state.nominal = arm_.state();
  state.last_loss = last_loss_;
  return state;
}

absl::StatusOr<AdapterState> Session::Export() {
  RS_RETURN_IF_ERROR(RequireAdapter("export"));
  return WithoutExceptions("export", [this] { return ExportAll(); });
}

absl::StatusOr<AdapterState> Session::ExportAll() {
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(AwaitLearned(0));
  AdaptationState state = CurrentAdaptation();
  std::vector<BufferedChunk> chunks;
  for (int i = 0; i < buffer_.size(); ++i) chunks.push_back(buffer_[i]);
  RS_ASSIGN_OR_RETURN(state.buffer, WithPrefixes(chunks));
  AdapterState result;
  RS_ASSIGN_OR_RETURN(result.safetensors,
                      SerializeAdaptationState(state, resources_.policy->lora_targets()));
  result.feedback_sequence = feedback_sequence_;
  result.updates_applied = state.lora.phi.version;
  return result;
}

absl::StatusOr<AdaptationState> Session::ReadAdaptation(const std::string& name,
                                                        const std::string& safetensors) const {
  RS_ASSIGN_OR_RETURN(
      AdaptationState state,
      ParseAdaptationState(name, safetensors, *resources_.policy, policy_spec().model_hash));
  if (state.method != spec_.method->method || state.policy != policy_spec().name) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the adapter was learned by method ", state.method, " on policy ", state.policy,
        "; this session runs method ", spec_.method->method, " on policy ", policy_spec().name));
  }
  const LoraOptions* lora = spec_.method->Find<LoraOptions>();
  if (lora != nullptr && state.lora_kind != lora->kind) {
    return absl::InvalidArgumentError(
        absl::StrCat("the adapter's parameters are ", LoraKindName(state.lora_kind),
                     "; this session's method has lora: ", LoraKindName(lora->kind),
                     "; open the session with the adapter's kind"));
  }
  return state;
}

absl::Status Session::ApplyAdaptation(const AdaptationState& state) {
  RS_RETURN_IF_ERROR(adapter_->Import(state.lora));
  triggers_ = state.triggers;
  feedback_sequence_ = state.feedback_sequence;
  schedule_.set_chunks(state.chunks_since_clear);
  buffer_.Clear();
  for (const auto& chunk : state.buffer) {  // the file has no observations to rebuild from
    buffer_.Add({nullptr, resources_.prefixes->Add(resources_.policy, nullptr, chunk->context),
                 chunk->target});
  }
  boundaries_.clear();
  outstanding_.clear();
  episode_.reset();
  if (state.task >= 0)
    episode_ = {static_cast<int>(state.task), -1};  // StartEpisode decides whether it is a boundary
  arm_.set_state(state.nominal);
  arm_episode_ = {static_cast<int>(state.nominal_task), static_cast<int>(state.nominal_episode)};
  last_loss_ = state.last_loss;
  return absl::OkStatus();
}

absl::StatusOr<FeedbackResult> Session::Import(const std::string& safetensors) {
  RS_RETURN_IF_ERROR(RequireAdapter("import into"));
  absl::StatusOr<AdaptationState> read =
      WithoutExceptions("import", [&] { return ReadAdaptation("imported adapter", safetensors); });
  if (absl::IsNotFound(read.status()))  // of a tensor
    return absl::InvalidArgumentError(read.status().message());
  RS_RETURN_IF_ERROR(read.status());
  const AdaptationState& state = *read;
  if (absl::Status valid = rules_.CheckAdaptation(state, state.buffer.size()); !valid.ok())
    return absl::InvalidArgumentError(absl::StrCat("imported adapter: ", valid.message()));
  absl::MutexLock order(&order_mu_);
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    RS_RETURN_IF_ERROR(adapter_->CheckShapes(state.lora));
  }
  v1::StateRecord record;
  if (durable()) record.mutable_imported()->set_safetensors(safetensors);
  RS_RETURN_IF_ERROR(Journal(record));
  absl::MutexLock lock(&mu_);
  const absl::Status applied = WithoutExceptions("import", [&] {
    mu_.AssertHeld();
    return ApplyAdaptation(state);
  });
  if (!applied.ok()) return failure_ = applied;
  return FeedbackResult{feedback_sequence_, updates_applied(), durable(), false};
}

absl::Status Session::Rollback(uint64_t version) {
  RS_RETURN_IF_ERROR(RequireAdapter("roll back"));
  absl::MutexLock order(&order_mu_);
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    RS_RETURN_IF_ERROR(adapter_->CheckRollback(version));
  }
  v1::StateRecord record;
  record.mutable_rollback()->set_version(version);
  RS_RETURN_IF_ERROR(Journal(record));
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(adapter_->Rollback(version));
  ClearBuffer();
  ++rollbacks_;
  return absl::OkStatus();
}

absl::Status Session::Pin(uint64_t version, bool pinned) {
  RS_RETURN_IF_ERROR(RequireAdapter("pin"));
  absl::MutexLock order(&order_mu_);
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    RS_RETURN_IF_ERROR(adapter_->CheckPin(version, pinned));
  }
  v1::StateRecord record;
  record.mutable_pin()->set_version(version);
  record.mutable_pin()->set_pinned(pinned);
  RS_RETURN_IF_ERROR(Journal(record));
  return adapter_->Pin(version, pinned);
}

absl::StatusOr<std::vector<PublishedVersion>> Session::Versions() const {
  RS_RETURN_IF_ERROR(RequireAdapter("list"));
  return adapter_->Versions();
}

absl::StatusOr<std::string> Session::ExportVersion(uint64_t version) {
  RS_ASSIGN_OR_RETURN(const std::vector<PublishedVersion> versions, Versions());
  for (const PublishedVersion& held : versions) {
    if (held.weights->version != version) continue;
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    AdaptationState state = CurrentAdaptation();
    state.lora.phi = *held.weights;
    state.lora.adam = InitialAdamState(Parameters(*held.weights));
    state.chunks_since_clear = 0;
    return SerializeAdaptationState(state, resources_.policy->lora_targets());
  }
  return absl::NotFoundError(
      absl::StrCat("version ", version, " is not held; list the versions for those that are"));
}

}  // namespace robostress
