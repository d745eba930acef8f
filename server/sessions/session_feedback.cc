#include <torch/types.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "server/inference/torch_threads.h"
#include "server/inference/without_exceptions.h"
#include "server/sessions/journal/session_events.h"
#include "server/sessions/session.h"

// What a session does with feedback: the journal, then learner, correction and predictions.
namespace robostress {

absl::StatusOr<FeedbackResult> Session::Feedback(const ExecutedChunk& executed) {
  return WithoutExceptions("feedback", [&] { return TakeFeedback(executed); });
}

absl::StatusOr<FeedbackResult> Session::TakeFeedback(const ExecutedChunk& executed) {
  UseOneTorchThread();
  RS_ASSIGN_OR_RETURN(const MeasuredChunk measured,
                      MeasuredChunk::Create(executed, policy_spec(), residual_options_));
  RS_RETURN_IF_ERROR(StateRules::CheckCount("sequence", executed.sequence));
  const std::string record = durable() ? EncodeEvent(executed) : std::string();

  absl::MutexLock order(&order_mu_);
  SnapshotIfDue();
  std::optional<Learner::Lesson> lesson;
  std::optional<CommandCorrection> correction;  // after it, where its episode is still open
  {
    absl::MutexLock lock(&mu_);
    const auto has_room = [this] {
      mu_.AssertHeld();
      return cancelled_ || learner_->pending() < kMaxPendingUpdates;
    };
    mu_.Await(absl::Condition(&has_room));
    RS_RETURN_IF_ERROR(CheckAlive());
    if (executed.sequence <= feedback_sequence_) {
      ++counted_.duplicates;
      return Acknowledge(true);
    }
    if (executed.sequence != feedback_sequence_ + 1) {
      return absl::FailedPreconditionError(absl::StrCat("feedback ", executed.sequence, " after ",
                                                        feedback_sequence_, "; send ",
                                                        feedback_sequence_ + 1, " first"));
    }
    RS_ASSIGN_OR_RETURN(Prediction * prediction, outstanding_.ReportedBy(executed));
    RS_ASSIGN_OR_RETURN(lesson, learner_->Prepare(measured, *prediction));
    if (episode_ == prediction->key.episode) {
      correction = correction_;
      correction->Observe(measured.usable());
    }
    if (durable()) RS_RETURN_IF_ERROR(AppendFeedback(record, *prediction));
  }
  RS_RETURN_IF_ERROR(SyncJournal());
  absl::MutexLock lock(&mu_);
  // Half applied is neither what the disk says nor what was before: it is read again.
  const absl::Status applied = WithoutExceptions("feedback", [&] {
    mu_.AssertHeld();
    Apply(measured, *std::move(lesson), std::move(correction));
    return absl::OkStatus();
  });
  if (!applied.ok()) return failure_ = applied;
  FeedbackResult result = Acknowledge(false);
  result.residual = measured.residual();
  return result;
}

void Session::Apply(const MeasuredChunk& measured, Learner::Lesson lesson,
                    std::optional<CommandCorrection> correction) {
  feedback_sequence_ = measured.reported().sequence;
  ++counted_.stats.feedback_chunks;
  counted_.steps_masked += measured.steps_masked();
  counted_.steps_impossible += measured.steps_impossible();
  if (auto update = learner_->Learn(std::move(lesson), feedback_sequence_))
    Post(*std::move(update));
  if (correction) correction_ = *std::move(correction);
  outstanding_.Settle(measured.reported().prediction_id);
}

void Session::Post(Learner::Update update) {
  resources_.LearningOf(spec_.mode)
      ->Post(owner_,
             [self = shared_from_this(), update = std::move(update)] { self->RunUpdate(update); });
}

void Session::RunUpdate(const Learner::Update& update) {
  {
    absl::MutexLock lock(&mu_);
    if (!CheckAlive().ok()) return learner_->Drop();
  }
  const absl::StatusOr<UpdateReport> report =
      WithoutExceptions("update", [&] { return learner_->Compute(update); });
  absl::MutexLock lock(&mu_);
  if (absl::Status status = learner_->Finish(update, report); !status.ok())
    failure_ = std::move(status);
}

}  // namespace robostress
