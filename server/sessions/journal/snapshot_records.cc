#include "server/sessions/journal/snapshot_records.h"

#include <google/protobuf/reflection.h>

#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/adaptation_state.h"
#include "adapter/method_options.h"
#include "common/check.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/state_records.h"
#include "server/sessions/outstanding_predictions.h"

namespace robostress {
namespace {

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

// All but the adapter.
v1::StateAdaptation CountersOf(const SessionSnapshot& snapshot) {
  v1::StateAdaptation record;
  record.set_feedback_sequence(snapshot.feedback_sequence);
  record.set_feedback_chunks(snapshot.feedback_chunks);
  record.set_next_prediction(snapshot.next_prediction);
  record.set_predictions(snapshot.predictions);
  record.set_predictions_dropped(snapshot.predictions_dropped);
  record.set_updates_refused(snapshot.learning.refused);
  record.set_updates_guarded(snapshot.learning.guarded);
  record.set_rollbacks(snapshot.learning.rollbacks);
  record.set_duplicates(snapshot.duplicates);
  record.set_steps_masked(snapshot.steps_masked);
  record.set_steps_impossible(snapshot.steps_impossible);
  record.set_episode_started(snapshot.episode_started);
  record.set_task(snapshot.task);
  record.set_episode(snapshot.episode);
  if (snapshot.next_chunk) record.set_next_chunk(*snapshot.next_chunk);
  record.mutable_boundaries()->Add(snapshot.boundaries.begin(), snapshot.boundaries.end());
  StoreCorrection(snapshot.correction, record);
  return record;
}

void TakeCounters(const v1::StateAdaptation& record, SessionSnapshot& snapshot) {
  snapshot.feedback_sequence = record.feedback_sequence();
  snapshot.feedback_chunks = record.feedback_chunks();
  snapshot.next_prediction = record.next_prediction();
  snapshot.predictions = record.predictions();
  snapshot.predictions_dropped = record.predictions_dropped();
  snapshot.learning = {record.updates_refused(), record.updates_guarded(), record.rollbacks()};
  snapshot.duplicates = record.duplicates();
  snapshot.steps_masked = record.steps_masked();
  snapshot.steps_impossible = record.steps_impossible();
  snapshot.episode_started = record.episode_started();
  snapshot.task = record.task();
  snapshot.episode = record.episode();
  snapshot.next_chunk.reset();
  if (record.has_next_chunk()) snapshot.next_chunk = record.next_chunk();
  snapshot.boundaries.assign(record.boundaries().begin(), record.boundaries().end());
  snapshot.correction = StoredCorrection(record);
}

absl::Status WriteSnapshot(const SessionSnapshot& snapshot, const std::vector<LoraTarget>& targets,
                           PrefixStore& prefixes, SessionJournal::Write write) {
  v1::StateRecord record;
  *record.mutable_adaptation() = CountersOf(snapshot);
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

absl::Status ReadBuffered(const v1::StateTrainingChunk& record, const SnapshotSources& sources,
                          std::vector<BufferedChunk>& buffer) {
  const LoraOptions* lora = sources.spec->method->Find<LoraOptions>();
  const size_t room = lora == nullptr ? 0 : static_cast<size_t>(lora->buffer_chunks);
  if (buffer.size() >= room) {
    return absl::DataLossError(absl::StrCat("more chunks are buffered than buffer_chunks, ", room));
  }
  RS_ASSIGN_OR_RETURN(StoredChunk chunk, FromRecord(record));
  RS_RETURN_IF_ERROR(
      sources.rules->CheckBuffered(chunk.target, chunk.observation.get(), chunk.context));
  auto prefix = chunk.observation != nullptr
                    ? sources.prefixes->AddDropped(sources.policy, chunk.observation)
                    : sources.prefixes->Add(sources.policy, nullptr, std::move(chunk.context));
  buffer.push_back({std::move(chunk.observation), std::move(prefix), std::move(chunk.target)});
  return absl::OkStatus();
}

absl::Status ReadOutstanding(const v1::StatePrediction& record, const SnapshotSources& sources,
                             std::vector<Prediction>& outstanding) {
  if (outstanding.size() >= OutstandingPredictions::kMost) {
    return absl::DataLossError(absl::StrCat("more than ", OutstandingPredictions::kMost,
                                            " predictions wait for feedback"));
  }
  RS_ASSIGN_OR_RETURN(Prediction prediction, FromRecord(record));
  RS_RETURN_IF_ERROR(sources.rules->CheckPrediction(prediction));
  if (prediction.observation != nullptr)
    prediction.prefix = sources.prefixes->AddDropped(sources.policy, prediction.observation);
  outstanding.push_back(std::move(prediction));
  return absl::OkStatus();
}

}  // namespace

absl::Status PublishSnapshot(SessionJournal& journal, const SessionSnapshot& snapshot,
                             const std::vector<LoraTarget>& targets, PrefixStore& prefixes) {
  return journal.PublishSnapshot([&](SessionJournal::Write write) {
    return WriteSnapshot(snapshot, targets, prefixes, write);
  });
}

absl::Status ReadSnapshotRecord(const v1::StateRecord& record, const SnapshotSources& sources,
                                SessionSnapshot& snapshot) {
  switch (record.record_case()) {
    case v1::StateRecord::kAdaptation: {
      TakeCounters(record.adaptation(), snapshot);
      if (record.adaptation().adapter().empty()) return absl::OkStatus();
      RS_ASSIGN_OR_RETURN(snapshot.adaptation,
                          sources.learner->Read("snapshot", record.adaptation().adapter()));
      return absl::OkStatus();
    }
    case v1::StateRecord::kBuffered:
      return ReadBuffered(record.buffered(), sources, snapshot.buffer);
    case v1::StateRecord::kPrediction:
      return ReadOutstanding(record.prediction(), sources, snapshot.outstanding);
    case v1::StateRecord::kVersion: {
      RS_ASSIGN_OR_RETURN(snapshot.versions.emplace_back(), FromRecord(record.version()));
      return absl::OkStatus();
    }
    default:
      return absl::DataLossError(absl::StrCat("a record of kind ", record.record_case(),
                                              " does not belong in a snapshot"));
  }
}

}  // namespace robostress
