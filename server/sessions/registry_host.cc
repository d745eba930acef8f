#include "server/sessions/registry_host.h"

#include <spdlog/spdlog.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

namespace {

void TakeCounters(const SessionCounters& counters, SessionFigures& figures) {
  figures.predictions = counters.predictions;
  figures.duplicates = counters.duplicates;
  figures.steps_impossible = counters.steps_impossible;
  figures.rollbacks = counters.rollbacks;
  figures.updates_applied = counters.stats.updates_applied;
  figures.updates_refused = counters.updates_refused;
  figures.updates_guarded = counters.updates_guarded;
  figures.adapter_distance = counters.stats.adapter_distance;
  figures.last_loss = counters.stats.last_loss;
  figures.buffered_chunks = counters.buffered_chunks;
  figures.journal_bytes = counters.journal_bytes;
  figures.snapshots_failed = counters.snapshots_failed;
  figures.predictions_unkept = counters.predictions_unkept;
}

}  // namespace

using Monotonic = std::chrono::steady_clock;

absl::StatusOr<SessionHost::Opened> RegistryHost::OpenSession(const Caller& caller,
                                                              const SessionSpec& spec) {
  RS_ASSIGN_OR_RETURN(const OpenedSession opened, registry_->Open({spec, guard_, {}}, caller));
  return Opened{opened.id, opened.token, opened.session->policy_spec(), opened.session->durable()};
}

absl::StatusOr<SessionHost::Resumed> RegistryHost::ResumeSession(const Caller& caller,
                                                                 const std::string& id,
                                                                 const std::string& token) {
  RS_ASSIGN_OR_RETURN(const OpenedSession opened, registry_->Resume(id, token, caller));
  const SessionPosition at = opened.session->Position();
  Resumed resumed{opened.session->policy_spec(), opened.session->durable(), at.feedback_sequence};
  if (at.episode) resumed.episode = EpisodeKey{at.episode->first, at.episode->second};
  resumed.next_chunk = at.next_chunk;
  resumed.control_period_s = opened.session->spec().control_period_s;
  return resumed;
}

absl::Status RegistryHost::CloseSession(const Caller& caller, const std::string& id) {
  SessionFigures last;
  bool known = false;
  if (const auto session = registry_->Use(id, caller); session.ok()) {
    TakeCounters((*session)->CountersNow(), last);
    known = true;
  }
  const absl::Status closed = registry_->Close(id, caller);
  if (closed.ok()) telemetry_->Forget(id, known ? &last : nullptr);
  return closed;
}

void RegistryHost::Attach(const std::string& id) { registry_->Attach(id); }
void RegistryHost::Detach(const std::string& id) { registry_->Detach(id); }

absl::Status RegistryHost::StartEpisode(const Caller& caller, const std::string& id,
                                        const EpisodeKey& key, uint64_t last_sequence) {
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id, caller));
  return session->StartEpisode(key.task, key.episode, last_sequence);
}

absl::StatusOr<PredictedChunk> RegistryHost::Predict(const Caller& caller, const std::string& id,
                                                     const Observation& observation,
                                                     const EpisodeKey& key, int chunk,
                                                     uint64_t last_sequence) {
  return Predict(caller, id, observation, key, chunk, last_sequence, {}, Monotonic::now());
}

absl::StatusOr<PredictedChunk> RegistryHost::Predict(const Caller& caller, const std::string& id,
                                                     const Observation& observation,
                                                     const EpisodeKey& key, int chunk,
                                                     uint64_t last_sequence, PredictOptions options,
                                                     Monotonic::time_point received) {
  const Monotonic::time_point begin = Monotonic::now();
  const auto trace = std::make_shared<PredictionTrace>(id, key.task, key.episode, chunk);
  trace->Add("decode", received, begin);
  const TraceScope scope(trace);
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id, caller));
  RS_ASSIGN_OR_RETURN(const SessionScheduling scheduling, registry_->SchedulingOf(id));
  if (options.priority == Priority::kUnspecified) options.priority = scheduling.priority;
  if (options.deadline == absl::InfiniteDuration() && scheduling.deadline_ms > 0)
    options.deadline = absl::Milliseconds(scheduling.deadline_ms);
  absl::StatusOr<PredictedChunk> prediction =
      session->Predict(observation, key.task, key.episode, chunk, last_sequence, options);
  const Monotonic::time_point end = Monotonic::now();
  trace->Add("predict", begin, end);
  traces_->Finish(trace);
  if (!prediction.ok()) {
    spdlog::info("prediction refused: {}", prediction.status().ToString());
    return prediction;
  }
  const double seconds = std::chrono::duration<double>(end - begin).count();
  telemetry_->Predicted(id, observation, seconds);
  spdlog::debug("predicted in {:.1f} ms with adapter version {}, batch of {}", 1e3 * seconds,
                prediction->adapter_version, prediction->batch_size);
  return prediction;
}

absl::StatusOr<SessionHost::Recalled> RegistryHost::Recall(const Caller& caller,
                                                           const std::string& id,
                                                           uint64_t prediction_id) {
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id, caller));
  RS_ASSIGN_OR_RETURN(const Prediction prediction, session->Recall(prediction_id));
  if (prediction.answered == nullptr) {
    return absl::FailedPreconditionError(absl::StrCat(
        "prediction ", prediction.id,
        " was made by an older server, which did not keep its actions; report the next one"));
  }
  return Recalled{{prediction.task, prediction.episode}, prediction.chunk, *prediction.answered};
}

absl::StatusOr<std::optional<SessionHost::Acknowledged>> RegistryHost::Repeated(
    const Caller& caller, const std::string& id, uint64_t sequence) {
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id, caller));
  const std::optional<FeedbackResult> result = session->Repeated(sequence);
  if (!result) return std::nullopt;
  return Acknowledged{result->sequence, result->updates_applied, result->durable, true};
}

absl::StatusOr<SessionHost::Acknowledged> RegistryHost::Feedback(const Caller& caller,
                                                                 const std::string& id,
                                                                 const ExecutedChunk& executed) {
  // For the log: no stage is timed.
  const TraceScope scope(
      std::make_shared<PredictionTrace>(id, executed.task, executed.episode, executed.chunk));
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id, caller));
  const absl::StatusOr<FeedbackResult> result = session->Feedback(executed);
  if (!result.ok()) {
    spdlog::warn("feedback {} refused: {}", executed.sequence, result.status().ToString());
    return result.status();
  }
  if (!result->duplicate) {
    telemetry_->Reported(id, session->spec(), executed);
    const SessionStats now = session->CountersNow().stats;
    telemetry_->Adapted(id, {now.updates_applied, now.adapter_distance, now.last_loss});
  }
  spdlog::debug("feedback {} taken, {} updates applied", result->sequence, result->updates_applied);
  return Acknowledged{result->sequence, result->updates_applied, result->durable,
                      result->duplicate};
}

std::vector<SessionFigures> RegistryHost::Figures() const {
  std::vector<SessionFigures> figures;
  for (const SessionRow& row : registry_->List()) {
    SessionFigures& f = figures.emplace_back();
    f.id = row.id;
    f.spec = row.request.spec;
    f.open = row.open;
    f.idle_s = absl::ToDoubleSeconds(row.idle);
    f.feedback_sequence = row.feedback_sequence;
    TakeCounters(row.counters, f);
    if (!row.error.ok()) f.error = row.error.ToString();
  }
  return figures;
}

}  // namespace robostress
