#include <torch/types.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/adam.h"
#include "adapter/adaptation_state.h"
#include "adapter/lora.h"
#include "adapter/method_options.h"
#include "common/status_macros.h"
#include "server/inference/without_exceptions.h"
#include "server/sessions/journal/session_events.h"
#include "server/sessions/session.h"

// A session's adaptation as a value: export, import, versions.
namespace robostress {

AdaptationState Session::CurrentAdaptation() {
  AdaptationState state = learner_->State();
  state.feedback_sequence = feedback_sequence_;
  state.task = episode_ ? episode_->task : -1;
  return state;
}

absl::StatusOr<AdapterState> Session::Export() {
  RS_RETURN_IF_ERROR(learner_->RequireAdapter("export"));
  return WithoutExceptions("export", [this] { return ExportAll(); });
}

absl::StatusOr<AdapterState> Session::ExportAll() {
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(AwaitLearned(0));
  AdaptationState state = CurrentAdaptation();
  RS_ASSIGN_OR_RETURN(state.buffer, learner_->WithPrefixes(learner_->Buffer()));
  AdapterState result;
  RS_ASSIGN_OR_RETURN(result.safetensors,
                      SerializeAdaptationState(state, resources_.policy->lora_targets()));
  result.feedback_sequence = feedback_sequence_;
  result.updates_applied = state.lora.phi.version;
  return result;
}

absl::Status Session::ApplyAdaptation(const AdaptationState& state) {
  RS_RETURN_IF_ERROR(learner_->Apply(state));
  feedback_sequence_ = state.feedback_sequence;
  outstanding_.Clear();
  episode_.reset();
  if (state.task >= 0)  // StartEpisode decides whether it is a boundary
    episode_ = EpisodeKey{static_cast<int>(state.task), -1};
  return absl::OkStatus();
}

absl::StatusOr<FeedbackResult> Session::Import(const std::string& safetensors) {
  RS_RETURN_IF_ERROR(learner_->RequireAdapter("import into"));
  absl::StatusOr<AdaptationState> read =
      WithoutExceptions("import", [&] { return learner_->Read("imported adapter", safetensors); });
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
    RS_RETURN_IF_ERROR(learner_->CheckShapes(state));
  }
  if (durable()) RS_RETURN_IF_ERROR(Journal(EncodeEvent(AdapterImported{safetensors})));
  absl::MutexLock lock(&mu_);
  const absl::Status applied = WithoutExceptions("import", [&] {
    mu_.AssertHeld();
    return ApplyAdaptation(state);
  });
  if (!applied.ok()) return failure_ = applied;
  return Acknowledge(false);
}

absl::Status Session::Rollback(uint64_t version) {
  RS_RETURN_IF_ERROR(learner_->RequireAdapter("roll back"));
  absl::MutexLock order(&order_mu_);
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    RS_RETURN_IF_ERROR(learner_->CheckRollback(version));
  }
  RS_RETURN_IF_ERROR(Journal(EncodeEvent(AdapterRolledBack{version})));
  absl::MutexLock lock(&mu_);
  return learner_->Rollback(version);
}

absl::Status Session::Pin(uint64_t version, bool pinned) {
  RS_RETURN_IF_ERROR(learner_->RequireAdapter("pin"));
  absl::MutexLock order(&order_mu_);
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    RS_RETURN_IF_ERROR(learner_->CheckPin(version, pinned));
  }
  RS_RETURN_IF_ERROR(Journal(EncodeEvent(VersionPinned{version, pinned})));
  return learner_->Pin(version, pinned);
}

absl::StatusOr<std::vector<PublishedVersion>> Session::Versions() const {
  RS_RETURN_IF_ERROR(learner_->RequireAdapter("list"));
  return learner_->Versions();
}

absl::StatusOr<std::string> Session::ExportVersion(uint64_t version) {
  RS_RETURN_IF_ERROR(learner_->RequireAdapter("export"));
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(AwaitLearned(0));
  for (const PublishedVersion& held : learner_->Versions()) {
    if (held.weights->version != version) continue;
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
