#include <spdlog/spdlog.h>
#include <torch/types.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "server/inference/torch_threads.h"
#include "server/inference/without_exceptions.h"
#include "server/sessions/journal/session_events.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/journal/session_recovery.h"
#include "server/sessions/journal/snapshot_records.h"
#include "server/sessions/session.h"
#include "server/sessions/session_snapshot.h"

// A session on disk: when it writes what, and how it is made again.
namespace robostress {

// ---------------------------------------------------------------------------------------- writing

void Session::SetJournal(std::unique_ptr<SessionJournal> journal) { journal_ = std::move(journal); }

void Session::AppendPrediction(const std::string& record, Prediction& prediction) {
  const absl::Status status = journal_->Append(record);
  prediction.journaled = status.ok();
  if (status.ok()) return;
  // A full disk stops learning, not the arm: the record is written again with its feedback.
  if (counted_.predictions_unkept++ == 0)
    spdlog::error("session {}: {}", SessionIdentity(spec_), status.ToString());
}

absl::Status Session::Journal(const std::string& event) {
  if (!durable()) return absl::OkStatus();
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(CheckAlive());
    RS_RETURN_IF_ERROR(journal_->Append(event));
  }
  return SyncJournal();
}

absl::Status Session::AppendFeedback(const std::string& record, Prediction& prediction) {
  if (!prediction.journaled) {
    RS_RETURN_IF_ERROR(journal_->Append(EncodeEvent(prediction)));
    prediction.journaled = true;
  }
  return journal_->Append(record);
}

absl::Status Session::SyncJournal() {
  if (!durable()) return absl::OkStatus();
  const absl::Status status = journal_->writer()->Sync();
  if (status.ok()) return status;
  absl::MutexLock lock(&mu_);
  failure_ = absl::DataLossError(
      absl::StrCat(status.message(), "; resume the session to go on with what is on the disk"));
  return failure_;
}

SessionSnapshot Session::Capture() {
  SessionSnapshot snapshot;
  snapshot.feedback_sequence = feedback_sequence_;
  snapshot.feedback_chunks = counted_.stats.feedback_chunks;
  snapshot.next_prediction = outstanding_.next();
  snapshot.predictions = outstanding_.made();
  snapshot.predictions_dropped = outstanding_.dropped();
  snapshot.duplicates = counted_.duplicates;
  snapshot.steps_masked = counted_.steps_masked;
  snapshot.steps_impossible = counted_.steps_impossible;
  snapshot.learning = learner_->counters();
  snapshot.episode_started = episode_.has_value();
  snapshot.task = episode_ ? episode_->task : -1;
  snapshot.episode = episode_ ? episode_->episode : -1;
  snapshot.next_chunk = static_cast<uint32_t>(next_chunk_);
  snapshot.boundaries.assign(learner_->boundaries().begin(), learner_->boundaries().end());
  snapshot.correction = correction_.state();
  if (learner_->adapts()) snapshot.adaptation = CurrentAdaptation();
  snapshot.versions = learner_->Versions();
  snapshot.buffer = learner_->Buffer();
  snapshot.outstanding = outstanding_.Kept();
  return snapshot;
}

absl::Status Session::TakeSnapshot() {
  RS_RETURN_IF_ERROR(journal_->PrepareGeneration());
  SessionSnapshot snapshot;
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
    snapshot = Capture();
    journal_->SwitchGeneration();
    outstanding_.MarkJournaled();  // those that the disk had no room for are in the snapshot
  }
  const absl::Status status =
      PublishSnapshot(*journal_, snapshot, resources_.policy->lora_targets(), *resources_.prefixes);
  if (status.ok()) return status;
  absl::MutexLock lock(&mu_);
  ++counted_.snapshots_failed;
  outstanding_.MarkAsIn(snapshot.outstanding);
  if (absl::IsDataLoss(status)) failure_ = status;
  return status;
}

uint64_t Session::SnapshotsDue() const {
  return std::max(journal_->bytes() / resources_.snapshot_bytes,
                  journal_->records() / resources_.snapshot_records);
}

void Session::PostSnapshot() {
  if (std::exchange(snapshot_posted_, true)) return;
  resources_.LearningOf(spec_.mode)->Post(owner_, [self = shared_from_this()] {
    self->SnapshotWhereQuiet();
  });
}

void Session::SnapshotWhereQuiet() {
  // Whoever holds it may wait for updates, which run on this thread after this.
  const bool alone = order_mu_.TryLock();
  bool quiet = false;
  {
    absl::MutexLock lock(&mu_);
    snapshot_posted_ = false;
    quiet = learner_->pending() == 0;
  }
  if (!alone) return;
  if (quiet) SnapshotIfDue();
  order_mu_.Unlock();
}

void Session::SnapshotIfDue() {
  if (!durable()) return;
  {
    absl::MutexLock lock(&mu_);
    const uint64_t share = SnapshotsDue();
    // An adapter that is always learning has no quiet moment: then one is made.
    if (share == 0 || (share < 4 && learner_->pending() > 0) || !CheckAlive().ok()) return;
  }
  if (absl::Status status = TakeSnapshot(); !status.ok())
    spdlog::error("session {}: no snapshot: {}", SessionIdentity(spec_), status.ToString());
}

absl::Status Session::Flush() {
  absl::MutexLock order(&order_mu_);
  if (!durable()) return absl::OkStatus();
  return TakeSnapshot();
}

// ---------------------------------------------------------------------------------------- reading

absl::Status Session::Restore(const SessionSnapshot& snapshot) {
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(rules_.CheckSnapshot(snapshot, OutstandingPredictions::kMost));
  if (learner_->adapts()) RS_RETURN_IF_ERROR(ApplyAdaptation(*snapshot.adaptation));
  RS_RETURN_IF_ERROR(learner_->Restore(snapshot.buffer, snapshot.versions, snapshot.boundaries,
                                       snapshot.learning));
  outstanding_.Restore(snapshot.outstanding, snapshot.next_prediction, snapshot.predictions,
                       snapshot.predictions_dropped);
  feedback_sequence_ = snapshot.feedback_sequence;
  counted_.stats.feedback_chunks = snapshot.feedback_chunks;
  counted_.duplicates = snapshot.duplicates;
  counted_.steps_masked = snapshot.steps_masked;
  counted_.steps_impossible = snapshot.steps_impossible;
  episode_.reset();
  if (snapshot.episode_started)
    episode_ = EpisodeKey{static_cast<int>(snapshot.task), static_cast<int>(snapshot.episode)};
  next_chunk_ = static_cast<int>(snapshot.next_chunk.value_or(0));
  for (const Prediction& prediction : snapshot.outstanding) {
    if (!snapshot.next_chunk && episode_ == prediction.key.episode)
      next_chunk_ = std::max(next_chunk_, prediction.key.chunk + 1);
  }
  if (!correction_.set_state(snapshot.correction)) {
    return absl::DataLossError(
        "state on disk: a correction of the commands that the method does not make, none where it "
        "makes one, or values that it cannot have");
  }
  return absl::OkStatus();
}

absl::Status Session::ReplayPrediction(Prediction prediction) {
  RS_RETURN_IF_ERROR(rules_.CheckPrediction(prediction));
  if (prediction.observation != nullptr)
    prediction.prefix = resources_.prefixes->AddDropped(resources_.policy, prediction.observation);
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(outstanding_.Skip(prediction.id));
  if (!outstanding_.Holds(prediction.id)) Remember(std::move(prediction));
  return absl::OkStatus();
}

absl::Status Session::ReplayEpisode(const EpisodeStarted& started) {
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(learner_->CheckBoundary(started.last_sequence, feedback_sequence_));
  ApplyEpisode(started);
  return absl::OkStatus();
}

absl::Status Session::Replay(SessionEvent event) {
  struct Visitor {
    Session& session;
    absl::Status operator()(Prediction& prediction) {
      return session.ReplayPrediction(std::move(prediction));
    }
    absl::Status operator()(const ExecutedChunk& chunk) {
      RS_ASSIGN_OR_RETURN(const FeedbackResult result, session.Feedback(chunk));
      if (!result.duplicate) return absl::OkStatus();
      return absl::DataLossError(absl::StrCat("feedback ", chunk.sequence, " comes twice"));
    }
    absl::Status operator()(const EpisodeStarted& started) {
      return session.ReplayEpisode(started);
    }
    absl::Status operator()(const AdapterImported& imported) {
      return session.Import(imported.safetensors).status();
    }
    absl::Status operator()(const AdapterRolledBack& back) {
      return session.Rollback(back.version);
    }
    absl::Status operator()(const VersionPinned& pin) {
      return session.Pin(pin.version, pin.pinned);
    }
  };
  return std::visit(Visitor{*this}, event);
}

absl::Status Session::Recover(const std::string& folder) {
  UseOneTorchThread();
  const absl::Status status =
      WithoutExceptions("recovery", [&] { return RecoverUnguarded(folder); });
  return absl::IsInternal(status) ? AsDamage(status) : status;
}

absl::Status Session::RecoverUnguarded(const std::string& folder) {
  const SnapshotSources sources{&spec_, resources_.policy, learner_.get(), &rules_,
                                resources_.prefixes.get()};
  RS_ASSIGN_OR_RETURN(
      journal_,
      RecoverJournal(
          folder, sources, [this](const SessionSnapshot& snapshot) { return Restore(snapshot); },
          [this](SessionEvent event) { return Replay(std::move(event)); }));
  // Updates that were under way are made again before anybody sees the adapter.
  absl::MutexLock lock(&mu_);
  const auto learned = [this] {
    mu_.AssertHeld();
    return learner_->pending() == 0;
  };
  mu_.Await(absl::Condition(&learned));
  return AsDamage(failure_);
}

}  // namespace robostress
