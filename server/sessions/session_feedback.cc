#include <spdlog/spdlog.h>
#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "adapter/compensation.h"
#include "adapter/method_options.h"
#include "adapter/plausible_motion.h"
#include "adapter/pseudo_target.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"
#include "server/inference/torch_threads.h"
#include "server/inference/without_exceptions.h"
#include "server/sessions/session.h"

// What a session does with feedback: checks, training chunk, buffer, update.
namespace robostress {

absl::StatusOr<Prediction*> Session::PredictionOf(const ExecutedChunk& executed) {
  if (executed.sequence != feedback_sequence_ + 1) {
    return absl::FailedPreconditionError(absl::StrCat("feedback ", executed.sequence, " after ",
                                                      feedback_sequence_, "; send ",
                                                      feedback_sequence_ + 1, " first"));
  }
  const auto found = outstanding_.find(executed.prediction_id);
  if (found == outstanding_.end()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "feedback ", executed.sequence, " is about prediction ", executed.prediction_id,
        ", which this session does not hold; it made ", next_prediction_ - 1, ", keeps the last ",
        kMaxOutstanding, " and none that is older than one already reported"));
  }
  const Prediction& prediction = found->second;
  if (prediction.task != executed.task || prediction.episode != executed.episode ||
      prediction.chunk != executed.chunk) {
    return absl::FailedPreconditionError(absl::StrCat(
        "feedback ", executed.sequence, " says task ", executed.task, " episode ", executed.episode,
        " chunk ", executed.chunk, "; prediction ", executed.prediction_id, " was made for task ",
        prediction.task, " episode ", prediction.episode, " chunk ", prediction.chunk));
  }
  return &found->second;
}

absl::StatusOr<BufferedChunk> Session::MakeTrainingChunk(const ExecutedChunk& executed,
                                                         const Prediction& prediction,
                                                         NominalArm& arm) {
  BufferedChunk chunk;
  chunk.observation = prediction.observation;
  chunk.prefix = prediction.prefix;
  const std::pair<int, int> episode{executed.task, executed.episode};
  if (executed.chunk == 0 || arm_episode_ != episode) {
    arm.Reset();
  }
  // eta = 0: the raw prediction itself, without a round trip through ToEnvironment.
  if (!spec_.method->Find<LoraOptions>()->use_residual) {
    chunk.target = prediction.raw;
    return chunk;
  }
  Eigen::MatrixXf base;
  if (prediction.base.rows() > 0) {
    base = prediction.base.middleRows(executed.first_step, executed.steps.size());
  }
  RS_ASSIGN_OR_RETURN(
      const Eigen::MatrixXd residual,
      ReferencedResidual(executed, spec_.method->target, residual_options_, base, &arm));
  try {
    torch::NoGradGuard no_grad;
    chunk.target =
        TargetChunk(prediction.raw, executed.first_step,
                    resources_.policy->ToModel(PseudoTarget(executed, residual), prediction.state));
    for (size_t i = 0; i < executed.masked.size(); ++i) {  // the prediction itself, in every bit
      const int64_t row = executed.first_step + static_cast<int64_t>(i);
      if (executed.masked[i]) chunk.target[row].copy_(prediction.raw[row]);
    }
    // A policy's transforms may pass float32 where a residual is large: nothing is learned of it.
    if (!torch::isfinite(chunk.target).all().item<bool>()) chunk.target = prediction.raw;
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("pseudo-target failed: ", error.what()));
  }
  return chunk;
}

absl::StatusOr<Session::TakenChunk> Session::Prepare(const ExecutedChunk& reported,
                                                     const Prediction& prediction) {
  TakenChunk taken{.arm = arm_};
  const std::vector<bool> impossible = ImpossibleSteps(reported);
  for (size_t i = 0; i < impossible.size(); ++i)
    taken.impossible += impossible[i] && !reported.IsMasked(i);
  const ExecutedChunk executed = WithMasked(reported, impossible);
  taken.prediction_id = prediction.id;
  if (adapter_ != nullptr) {
    RS_ASSIGN_OR_RETURN(taken.training, MakeTrainingChunk(executed, prediction, taken.arm));
  }
  if (episode_ == std::pair(executed.task, executed.episode)) {
    taken.correction = correction_;
    taken.correction->Observe(executed);
  }
  return taken;
}

void Session::Apply(const ExecutedChunk& executed, TakenChunk taken) {
  feedback_sequence_ = executed.sequence;
  ++feedback_chunks_;
  steps_masked_ += static_cast<uint64_t>(absl::c_count(executed.masked, true));
  steps_impossible_ += taken.impossible;
  if (taken.training) {
    arm_ = taken.arm;
    arm_episode_ = {executed.task, executed.episode};
    buffer_.Add(*std::move(taken.training));
    if (schedule_.Add()) TriggerUpdate();
  }
  if (taken.correction) correction_ = *std::move(taken.correction);
  // A later prediction was made after this one: what is older will not be executed any more.
  outstanding_.erase(outstanding_.begin(), outstanding_.lower_bound(taken.prediction_id));
  if (boundaries_.erase(feedback_sequence_) > 0) ClearBuffer();
}

absl::StatusOr<FeedbackResult> Session::Feedback(const ExecutedChunk& executed) {
  return WithoutExceptions("feedback", [&] { return TakeFeedback(executed); });
}

absl::StatusOr<FeedbackResult> Session::TakeFeedback(const ExecutedChunk& executed) {
  UseOneTorchThread();
  RS_RETURN_IF_ERROR(
      ValidateExecutedChunk(executed, policy_spec().action_dim, residual_options_.space));
  RS_RETURN_IF_ERROR(CheckExecutedChunk(executed, policy_spec()));
  RS_RETURN_IF_ERROR(StateRules::CheckCount("sequence", executed.sequence));

  absl::MutexLock order(&order_mu_);
  SnapshotIfDue();
  std::optional<TakenChunk> taken;
  {
    absl::MutexLock lock(&mu_);
    const auto has_room = [this] {
      mu_.AssertHeld();
      return cancelled_ || pending_updates_ < kMaxPendingUpdates;
    };
    mu_.Await(absl::Condition(&has_room));
    if (cancelled_) return absl::CancelledError("the session was closed");
    RS_RETURN_IF_ERROR(failure_);
    if (executed.sequence <= feedback_sequence_) {
      ++duplicates_;
      return FeedbackResult{feedback_sequence_, updates_applied(), durable(), true};
    }
    RS_ASSIGN_OR_RETURN(Prediction * prediction, PredictionOf(executed));
    RS_ASSIGN_OR_RETURN(taken, Prepare(executed, *prediction));
    RS_RETURN_IF_ERROR(JournalFeedback(executed, *prediction));
  }
  RS_RETURN_IF_ERROR(SyncJournal());
  absl::MutexLock lock(&mu_);
  // Half applied is neither what the disk says nor what was before: it is read again.
  const absl::Status applied = WithoutExceptions("feedback", [&] {
    mu_.AssertHeld();
    Apply(executed, *std::move(taken));
    return absl::OkStatus();
  });
  if (!applied.ok()) return failure_ = applied;
  return FeedbackResult{feedback_sequence_, updates_applied(), durable(), false};
}

void Session::TriggerUpdate() {
  const uint64_t index = triggers_++;
  const StreamKey key = key_.With("update").With(static_cast<int64_t>(index));
  // The batch, and for the guard what follows it in the same permutation.
  const int size = spec_.method->Find<LoraOptions>()->batch;
  const int held_out = guard_.enabled ? std::min(guard_.chunks, buffer_.size() - size) : 0;
  std::vector<BufferedChunk> batch, rest;
  for (const int i : SampleWithoutReplacement(key.With("batch"), buffer_.size(), size + held_out)) {
    auto& into = static_cast<int>(batch.size()) < size ? batch : rest;
    into.push_back(buffer_[i]);
  }
  ++pending_updates_;
  AdaptationLoop* const loop =
      spec_.mode == ExecutionMode::kLockstep && resources_.lockstep_adaptation != nullptr
          ? resources_.lockstep_adaptation
          : resources_.adaptation;
  loop->Post(owner_,
             [self = shared_from_this(), index, batch = std::move(batch), rest = std::move(rest),
              sequence = feedback_sequence_] { self->RunUpdate(index, batch, rest, sequence); });
}

absl::StatusOr<std::vector<std::shared_ptr<const TrainingChunk>>> Session::WithPrefixes(
    const std::vector<BufferedChunk>& chunks) const {
  std::vector<std::shared_ptr<const TrainingChunk>> result;
  for (const BufferedChunk& chunk : chunks) {
    RS_ASSIGN_OR_RETURN(PolicyContext context, resources_.prefixes->Get(*chunk.prefix));
    result.push_back(
        std::make_shared<const TrainingChunk>(TrainingChunk{std::move(context), chunk.target}));
  }
  return result;
}

void Session::RunUpdate(uint64_t index, const std::vector<BufferedChunk>& batch,
                        const std::vector<BufferedChunk>& held_out, uint64_t sequence) {
  {
    absl::MutexLock lock(&mu_);
    if (cancelled_ || !failure_.ok()) {
      --pending_updates_;
      return;
    }
  }
  const absl::StatusOr<UpdateReport> report =
      WithoutExceptions("update", [&]() -> absl::StatusOr<UpdateReport> {
        RS_ASSIGN_OR_RETURN(const auto chunks, WithPrefixes(batch));
        UpdateContext context{sequence, guard_, {}};
        RS_ASSIGN_OR_RETURN(context.held_out, WithPrefixes(held_out));
        return adapter_->Update(index, chunks, context);
      });
  absl::MutexLock lock(&mu_);
  --pending_updates_;
  if (!report.ok()) {
    failure_ = report.status();
    spdlog::error("session {}: {}", SessionIdentity(spec_), report.status().ToString());
    return;
  }
  if (std::isfinite(report->loss)) last_loss_ = report->loss;
  if (report->applied) return;
  if (report->verdict) {
    ++updates_guarded_;
    spdlog::warn("session {}: update {} refused by the guard, loss {} after {}, distance {}",
                 SessionIdentity(spec_), index, report->verdict->candidate_loss,
                 report->verdict->published_loss, report->verdict->candidate_distance);
    return;
  }
  ++updates_refused_;
  spdlog::warn("session {}: update {} refused, loss {} gradient norm {}", SessionIdentity(spec_),
               index, report->loss, report->gradient_norm);
}

}  // namespace robostress
