#include <google/protobuf/reflection.h>
#include <spdlog/spdlog.h>
#include <torch/types.h>

#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/adaptation_state.h"
#include "adapter/method_options.h"
#include "common/check.h"
#include "common/rollout/message_limits.h"
#include "common/rpc/convert_chunks.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/inference/torch_threads.h"
#include "server/inference/without_exceptions.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/journal/state_records.h"
#include "server/sessions/session.h"
#include "server/sessions/session_snapshot.h"

// A session on disk: what it writes to its journal, its snapshots, and how it is made from them.
namespace robostress {

namespace {

// `status` as one of the disk. What has nothing to do with what it holds stays as it is.
absl::Status Damaged(const absl::Status& status) {
  if (status.ok() || absl::IsDataLoss(status) || absl::IsCancelled(status) ||
      absl::IsDeadlineExceeded(status) || absl::IsResourceExhausted(status))
    return status;
  return absl::DataLossError(absl::StrCat("state on disk: ", status.message()));
}

// A corrector's state is the field of numbers with the name of its way.
void StoreCorrection(const CommandCorrection::State& state, v1::StateAdaptation& counters) {
  for (const auto& [name, values] : state) {
    const auto* field = counters.GetDescriptor()->FindFieldByName(name);
    RS_CHECK(field != nullptr);  // a way whose state has no field in state.proto
    auto into = counters.GetReflection()->GetMutableRepeatedFieldRef<double>(&counters, field);
    for (const double value : values) into.Add(value);
  }
}

CommandCorrection::State StoredCorrection(const v1::StateAdaptation& counters) {
  CommandCorrection::State state;
  std::vector<const google::protobuf::FieldDescriptor*> fields;
  counters.GetReflection()->ListFields(counters, &fields);
  for (const auto* field : fields) {
    if (!field->is_repeated() || field->cpp_type() != field->CPPTYPE_DOUBLE) continue;
    const auto values = counters.GetReflection()->GetRepeatedFieldRef<double>(counters, field);
    Eigen::VectorXd& into = state[std::string(field->name())];
    into.resize(values.size());
    std::copy(values.begin(), values.end(), into.begin());
  }
  return state;
}

absl::Status WriteSnapshot(const SessionSnapshot& snapshot, const std::vector<LoraTarget>& targets,
                           PrefixStore& prefixes, SessionJournal::Write write) {
  v1::StateRecord record;
  *record.mutable_adaptation() = snapshot.counters;
  if (snapshot.adaptation) {
    RS_ASSIGN_OR_RETURN(*record.mutable_adaptation()->mutable_adapter(),
                        SerializeAdaptationState(*snapshot.adaptation, targets));
  }
  RS_RETURN_IF_ERROR(write(record));
  for (const BufferedChunk& chunk : snapshot.buffer) {
    if (chunk.observation != nullptr) {
      *record.mutable_buffered() = ToRecord(chunk, nullptr);
    } else {
      RS_ASSIGN_OR_RETURN(const PolicyContext context, prefixes.Get(*chunk.prefix));
      *record.mutable_buffered() = ToRecord(chunk, &context);
    }
    RS_RETURN_IF_ERROR(write(record));
  }
  for (const Prediction& prediction : snapshot.outstanding) {
    *record.mutable_prediction() = ToRecord(prediction);
    RS_RETURN_IF_ERROR(write(record));
  }
  for (const PublishedVersion& version : snapshot.versions) {
    *record.mutable_version() = ToRecord(version);
    RS_RETURN_IF_ERROR(write(record));
  }
  return absl::OkStatus();
}

}  // namespace

// ---------------------------------------------------------------------------------------- writing

void Session::SetJournal(std::unique_ptr<SessionJournal> journal) { journal_ = std::move(journal); }

std::string Session::PredictionRecord(const Prediction& prediction) const {
  if (journal_ == nullptr) return {};
  v1::StateRecord record;
  *record.mutable_prediction() = ToRecord(prediction);
  return record.SerializeAsString();
}

void Session::JournalPrediction(const std::string& record, Prediction& prediction) {
  const absl::Status status = journal_->AppendSerialized(record);
  prediction.journaled = status.ok();
  if (status.ok()) return;
  // A full disk stops learning, not the arm: the record is written again with its feedback.
  if (predictions_unkept_++ == 0)
    spdlog::error("session {}: {}", SessionIdentity(spec_), status.ToString());
}

absl::Status Session::Journal(const v1::StateRecord& record) {
  if (journal_ == nullptr) return absl::OkStatus();
  {
    absl::MutexLock lock(&mu_);
    if (cancelled_) return absl::CancelledError("the session was closed");
    RS_RETURN_IF_ERROR(failure_);
    RS_RETURN_IF_ERROR(journal_->Append(record));
  }
  return SyncJournal();
}

absl::Status Session::JournalFeedback(const ExecutedChunk& executed, Prediction& prediction) {
  if (journal_ == nullptr) return absl::OkStatus();
  v1::StateRecord record;
  if (!prediction.journaled) {
    *record.mutable_prediction() = ToRecord(prediction);
    RS_RETURN_IF_ERROR(journal_->Append(record));
    prediction.journaled = true;
  }
  *record.mutable_feedback()->mutable_chunk() = ToProto(executed);
  return journal_->Append(record);
}

absl::Status Session::SyncJournal() {
  if (journal_ == nullptr) return absl::OkStatus();
  const absl::Status status = journal_->writer()->Sync();
  if (status.ok()) return status;
  absl::MutexLock lock(&mu_);
  failure_ = absl::DataLossError(
      absl::StrCat(status.message(), "; resume the session to go on with what is on the disk"));
  return failure_;
}

SessionSnapshot Session::Capture() {
  SessionSnapshot snapshot;
  v1::StateAdaptation& counters = snapshot.counters;
  counters.set_feedback_sequence(feedback_sequence_);
  counters.set_feedback_chunks(feedback_chunks_);
  counters.set_next_prediction(next_prediction_);
  counters.set_predictions(predictions_);
  counters.set_predictions_dropped(predictions_dropped_);
  counters.set_updates_refused(updates_refused_);
  counters.set_updates_guarded(updates_guarded_);
  counters.set_duplicates(duplicates_);
  counters.set_rollbacks(rollbacks_);
  counters.set_steps_masked(steps_masked_);
  counters.set_steps_impossible(steps_impossible_);
  counters.set_episode_started(episode_.has_value());
  counters.set_task(episode_ ? episode_->first : -1);
  counters.set_episode(episode_ ? episode_->second : -1);
  counters.set_next_chunk(static_cast<uint32_t>(next_chunk_));
  for (const uint64_t boundary : boundaries_) counters.add_boundaries(boundary);
  StoreCorrection(correction_.state(), counters);
  if (adapter_ != nullptr) {
    snapshot.adaptation = CurrentAdaptation();
    snapshot.versions = adapter_->Versions();
  }
  for (int i = 0; i < buffer_.size(); ++i) snapshot.buffer.push_back(buffer_[i]);
  for (auto& [id, prediction] : outstanding_) snapshot.outstanding.push_back(prediction);
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
    // Those that the disk had no room for are in the snapshot.
    for (auto& [id, prediction] : outstanding_) prediction.journaled = true;
  }
  const absl::Status status = journal_->PublishSnapshot([&](SessionJournal::Write write) {
    return WriteSnapshot(snapshot, resources_.policy->lora_targets(), *resources_.prefixes, write);
  });
  if (status.ok()) return status;
  absl::MutexLock lock(&mu_);
  ++snapshots_failed_;
  for (const Prediction& prediction : snapshot.outstanding) {
    const auto found = outstanding_.find(prediction.id);
    if (found != outstanding_.end()) found->second.journaled = prediction.journaled;
  }
  if (absl::IsDataLoss(status)) failure_ = status;
  return status;
}

void Session::SnapshotIfDue() {
  if (journal_ == nullptr) return;
  {
    absl::MutexLock lock(&mu_);
    const uint64_t share = std::max(journal_->bytes() / resources_.snapshot_bytes,
                                    journal_->records() / resources_.snapshot_records);
    // An adapter that is always learning has no quiet moment: then one is made.
    if (share == 0 || (share < 4 && pending_updates_ > 0) || cancelled_ || !failure_.ok()) return;
  }
  if (absl::Status status = TakeSnapshot(); !status.ok())
    spdlog::error("session {}: no snapshot: {}", SessionIdentity(spec_), status.ToString());
}

absl::Status Session::Flush() {
  absl::MutexLock order(&order_mu_);
  if (journal_ == nullptr) return absl::OkStatus();
  return TakeSnapshot();
}

// ---------------------------------------------------------------------------------------- reading

std::shared_ptr<const PrefixStore::Prefix> Session::PrefixOf(
    const std::shared_ptr<const Observation>& observation) const {
  return resources_.prefixes->AddDropped(resources_.policy, observation);
}

absl::Status Session::Restore(const SessionSnapshot& snapshot) {
  const v1::StateAdaptation& counters = snapshot.counters;
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(rules_.CheckSnapshot(snapshot, kMaxOutstanding));
  if (adapter_ != nullptr) {
    RS_RETURN_IF_ERROR(ApplyAdaptation(*snapshot.adaptation));
    RS_RETURN_IF_ERROR(adapter_->RestoreVersions(snapshot.versions));
  }
  for (const BufferedChunk& chunk : snapshot.buffer) buffer_.Add(chunk);
  for (const Prediction& prediction : snapshot.outstanding)
    outstanding_.emplace(prediction.id, prediction);
  feedback_sequence_ = counters.feedback_sequence();
  feedback_chunks_ = counters.feedback_chunks();
  next_prediction_ = counters.next_prediction();
  predictions_ = counters.predictions();
  predictions_dropped_ = counters.predictions_dropped();
  updates_refused_ = counters.updates_refused();
  updates_guarded_ = counters.updates_guarded();
  duplicates_ = counters.duplicates();
  rollbacks_ = counters.rollbacks();
  steps_masked_ = counters.steps_masked();
  steps_impossible_ = counters.steps_impossible();
  episode_.reset();
  if (counters.episode_started())
    episode_ = {static_cast<int>(counters.task()), static_cast<int>(counters.episode())};
  if (counters.next_chunk() > static_cast<uint32_t>(WireLimits::kIndex))
    return absl::DataLossError(absl::StrCat("state on disk: next_chunk is ", counters.next_chunk(),
                                            ", at most ", WireLimits::kIndex));
  next_chunk_ = static_cast<int>(counters.next_chunk());
  for (const Prediction& prediction : snapshot.outstanding) {
    if (!counters.has_next_chunk() && episode_ == std::pair(prediction.task, prediction.episode))
      next_chunk_ = std::max(next_chunk_, prediction.chunk + 1);
  }
  boundaries_.insert(counters.boundaries().begin(), counters.boundaries().end());
  if (!correction_.set_state(StoredCorrection(counters))) {
    return absl::DataLossError(
        "state on disk: a correction of the commands that the method does not make, none where it "
        "makes one, or values that it cannot have");
  }
  return absl::OkStatus();
}

absl::StatusOr<Prediction> Session::ReadPrediction(const v1::StatePrediction& record) const {
  RS_ASSIGN_OR_RETURN(Prediction prediction, FromRecord(record));
  RS_RETURN_IF_ERROR(rules_.CheckPrediction(prediction));
  if (prediction.observation != nullptr) prediction.prefix = PrefixOf(prediction.observation);
  return prediction;
}

absl::Status Session::ReplayEpisode(int64_t task, int64_t episode, uint64_t last_sequence) {
  RS_RETURN_IF_ERROR(StateRules::CheckEpisode(task, episode));
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(CheckBoundary(last_sequence));
  ApplyEpisode(static_cast<int>(task), static_cast<int>(episode), last_sequence);
  return absl::OkStatus();
}

absl::Status Session::Replay(const v1::StateRecord& record) {
  switch (record.record_case()) {
    case v1::StateRecord::kPrediction: {
      RS_ASSIGN_OR_RETURN(Prediction prediction, ReadPrediction(record.prediction()));
      absl::MutexLock lock(&mu_);
      RS_RETURN_IF_ERROR(StateRules::CheckCount("prediction", prediction.id + 1));
      next_prediction_ = std::max(next_prediction_, prediction.id + 1);
      if (outstanding_.count(prediction.id) == 0) Remember(std::move(prediction));
      return absl::OkStatus();
    }
    case v1::StateRecord::kFeedback: {
      RS_ASSIGN_OR_RETURN(const ExecutedChunk chunk, FromProto(record.feedback().chunk()));
      RS_ASSIGN_OR_RETURN(const FeedbackResult result, Feedback(chunk));
      if (!result.duplicate) return absl::OkStatus();
      return absl::DataLossError(absl::StrCat("feedback ", chunk.sequence, " comes twice"));
    }
    case v1::StateRecord::kEpisode:
      return ReplayEpisode(record.episode().task(), record.episode().episode(),
                           record.episode().last_feedback_sequence());
    case v1::StateRecord::kRollback:
      return Rollback(record.rollback().version());
    case v1::StateRecord::kPin:
      return Pin(record.pin().version(), record.pin().pinned());
    case v1::StateRecord::kImported:
      return Import(record.imported().safetensors()).status();
    default:
      return absl::DataLossError(
          absl::StrCat("a record of kind ", record.record_case(), " does not belong in a journal"));
  }
}

absl::Status Session::ReadSnapshotRecord(const v1::StateRecord& record,
                                         SessionSnapshot& snapshot) const {
  switch (record.record_case()) {
    case v1::StateRecord::kAdaptation: {
      snapshot.counters = record.adaptation();
      if (record.adaptation().adapter().empty()) return absl::OkStatus();
      RS_ASSIGN_OR_RETURN(snapshot.adaptation,
                          ReadAdaptation("snapshot", record.adaptation().adapter()));
      return absl::OkStatus();
    }
    case v1::StateRecord::kBuffered: {
      const LoraOptions* lora = spec_.method->Find<LoraOptions>();
      const size_t room = lora == nullptr ? 0 : lora->buffer_chunks;
      if (snapshot.buffer.size() >= room) {
        return absl::DataLossError(
            absl::StrCat("more chunks are buffered than buffer_chunks, ", room));
      }
      RS_ASSIGN_OR_RETURN(StoredChunk chunk, FromRecord(record.buffered()));
      RS_RETURN_IF_ERROR(
          rules_.CheckBuffered(chunk.target, chunk.observation.get(), chunk.context));
      auto prefix = chunk.observation != nullptr
                        ? PrefixOf(chunk.observation)
                        : resources_.prefixes->Add(resources_.policy, nullptr, chunk.context);
      snapshot.buffer.push_back({chunk.observation, std::move(prefix), chunk.target});
      return absl::OkStatus();
    }
    case v1::StateRecord::kPrediction: {
      if (snapshot.outstanding.size() >= kMaxOutstanding)
        return absl::DataLossError(
            absl::StrCat("more than ", kMaxOutstanding, " predictions wait for feedback"));
      RS_ASSIGN_OR_RETURN(snapshot.outstanding.emplace_back(), ReadPrediction(record.prediction()));
      return absl::OkStatus();
    }
    case v1::StateRecord::kVersion: {
      RS_ASSIGN_OR_RETURN(snapshot.versions.emplace_back(), FromRecord(record.version()));
      return absl::OkStatus();
    }
    default:
      return absl::DataLossError(absl::StrCat("a record of kind ", record.record_case(),
                                              " does not belong in a snapshot"));
  }
}

absl::Status Session::Recover(const std::string& folder) {
  UseOneTorchThread();
  const absl::Status status =
      WithoutExceptions("recovery", [&] { return RecoverUnguarded(folder); });
  return absl::IsInternal(status) ? Damaged(status) : status;
}

absl::Status Session::RecoverUnguarded(const std::string& folder) {
  RS_ASSIGN_OR_RETURN(const v1::StateHeader header, SessionJournal::ReadHeader(folder));
  if (header.model_hash() != policy_spec().model_hash) {
    return absl::FailedPreconditionError(absl::StrCat(
        folder, ": was adapted on weights '", header.model_hash(), "'; policy ", policy_spec().name,
        " has '", policy_spec().model_hash, "': serve those weights, or close the session"));
  }
  std::optional<SessionSnapshot> snapshot;
  const auto begin = [&](const v1::StateRecord& record) -> absl::Status {
    if (!snapshot) snapshot.emplace();
    return Damaged(ReadSnapshotRecord(record, *snapshot));
  };
  bool restored = false;
  const auto restore = [&]() -> absl::Status {
    if (std::exchange(restored, true) || !snapshot) return absl::OkStatus();
    return Damaged(Restore(*snapshot));
  };
  const auto replay = [&](const v1::StateRecord& record) -> absl::Status {
    RS_RETURN_IF_ERROR(restore());
    return Damaged(Replay(record));
  };
  absl::StatusOr<std::unique_ptr<SessionJournal>> journal =
      SessionJournal::Recover(folder, begin, replay, [&] { snapshot.reset(); });
  RS_RETURN_IF_ERROR(journal.status());
  RS_RETURN_IF_ERROR(restore());
  journal_ = *std::move(journal);
  // Updates that were under way are made again before anybody sees the adapter.
  absl::MutexLock lock(&mu_);
  const auto learned = [this] {
    mu_.AssertHeld();
    return pending_updates_ == 0;
  };
  mu_.Await(absl::Condition(&learned));
  return Damaged(failure_);
}

}  // namespace robostress
