#include "server/registry_host.h"

#include <spdlog/spdlog.h>

#include <utility>

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
}

}  // namespace

using Monotonic = std::chrono::steady_clock;

absl::StatusOr<SessionHost::Opened> RegistryHost::OpenSession(const Caller&,
                                                              const SessionSpec& spec) {
  RS_ASSIGN_OR_RETURN(const OpenedSession opened, registry_->Open({spec, guard_, {}}));
  return Opened{opened.id, opened.token, opened.session->policy_spec(), opened.session->durable()};
}

absl::StatusOr<SessionHost::Resumed> RegistryHost::ResumeSession(const Caller&,
                                                                 const std::string& id,
                                                                 const std::string& token) {
  RS_ASSIGN_OR_RETURN(const OpenedSession opened, registry_->Resume(id, token));
  return Resumed{opened.session->policy_spec(), opened.session->durable(),
                 opened.session->Position().feedback_sequence, std::nullopt, 0};
}

absl::Status RegistryHost::CloseSession(const Caller&, const std::string& id) {
  SessionFigures last;
  bool known = false;
  if (const auto session = registry_->Use(id); session.ok()) {
    TakeCounters((*session)->CountersNow(), last);
    known = true;
  }
  const absl::Status closed = registry_->Close(id);
  if (closed.ok()) telemetry_->Forget(id, known ? &last : nullptr);
  return closed;
}

void RegistryHost::Attach(const std::string&) {}
void RegistryHost::Detach(const std::string&) {}

absl::Status RegistryHost::StartEpisode(const Caller&, const std::string& id, const EpisodeKey& key,
                                        uint64_t last_sequence) {
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id));
  return session->StartEpisode(key.task, key.episode, last_sequence);
}

absl::StatusOr<PredictedChunk> RegistryHost::Predict(const Caller& caller, const std::string& id,
                                                     const Observation& observation,
                                                     const EpisodeKey& key, int chunk,
                                                     uint64_t last_sequence) {
  return Predict(caller, id, observation, key, chunk, last_sequence, {}, Monotonic::now());
}

absl::StatusOr<PredictedChunk> RegistryHost::Predict(const Caller&, const std::string& id,
                                                     const Observation& observation,
                                                     const EpisodeKey& key, int chunk,
                                                     uint64_t last_sequence, PredictOptions options,
                                                     Monotonic::time_point received) {
  const Monotonic::time_point begin = Monotonic::now();
  const auto trace = std::make_shared<PredictionTrace>(id, key.task, key.episode, chunk);
  trace->Add("decode", received, begin);
  const TraceScope scope(trace);
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id));
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

absl::StatusOr<SessionHost::Acknowledged> RegistryHost::Feedback(const Caller&,
                                                                 const std::string& id,
                                                                 const ExecutedChunk& executed) {
  // For the log: no stage is timed.
  const TraceScope scope(
      std::make_shared<PredictionTrace>(id, executed.task, executed.episode, executed.chunk));
  RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session, registry_->Use(id));
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
