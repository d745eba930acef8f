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

using Monotonic = std::chrono::steady_clock;

class ShownUse : public SessionUse {
 public:
  ShownUse(std::string id, SessionRegistry::Lease session, Telemetry* telemetry, TraceLog* traces)
      : id_(std::move(id)), session_(std::move(session)), telemetry_(telemetry), traces_(traces) {}

  absl::Status StartEpisode(const EpisodeKey& key, uint64_t last_sequence) override {
    return session_->StartEpisode(key, last_sequence);
  }

  absl::StatusOr<PredictedChunk> Predict(std::shared_ptr<const Observation> observation,
                                         const ChunkKey& key, uint64_t last_sequence,
                                         PredictOptions options,
                                         Monotonic::time_point received) override {
    const Monotonic::time_point begin = Monotonic::now();
    const auto trace =
        std::make_shared<PredictionTrace>(id_, key.episode.task, key.episode.episode, key.chunk);
    trace->Add("decode", received, begin);
    const TraceScope scope(trace);
    const SessionScheduling& scheduling = session_.scheduling();
    if (options.priority == Priority::kUnspecified) options.priority = scheduling.priority;
    if (options.deadline == absl::InfiniteDuration() && scheduling.deadline_ms > 0)
      options.deadline = absl::Milliseconds(scheduling.deadline_ms);
    absl::StatusOr<PredictedChunk> prediction =
        session_->Predict(observation, key, last_sequence, options);
    const Monotonic::time_point end = Monotonic::now();
    trace->Add("predict", begin, end);
    traces_->Finish(trace);
    if (!prediction.ok()) {
      spdlog::info("prediction refused: {}", prediction.status().ToString());
      return prediction;
    }
    const double seconds = std::chrono::duration<double>(end - begin).count();
    telemetry_->Predicted(id_, observation, seconds);
    spdlog::debug("predicted in {:.1f} ms with adapter version {}, batch of {}", 1e3 * seconds,
                  prediction->adapter_version, prediction->batch_size);
    return prediction;
  }

  absl::StatusOr<Recalled> Recall(uint64_t prediction_id) override {
    RS_ASSIGN_OR_RETURN(const Prediction prediction, session_->Recall(prediction_id));
    if (prediction.answered != nullptr) return Recalled{prediction.key, *prediction.answered};
    return absl::FailedPreconditionError(absl::StrCat(
        "prediction ", prediction.id,
        " was made by an older server, which did not keep its actions; report the next one"));
  }

  std::optional<FeedbackResult> Repeated(uint64_t sequence) override {
    return session_->Repeated(sequence);
  }

  absl::StatusOr<FeedbackResult> Feedback(const ExecutedChunk& executed) override {
    // For the log: no stage is timed.
    const TraceScope scope(
        std::make_shared<PredictionTrace>(id_, executed.task, executed.episode, executed.chunk));
    absl::StatusOr<FeedbackResult> result = session_->Feedback(executed);
    if (!result.ok()) {
      spdlog::warn("feedback {} refused: {}", executed.sequence, result.status().ToString());
      return result;
    }
    if (!result->duplicate) {
      telemetry_->Reported(id_, session_->spec(), result->sequence, result->residual);
      telemetry_->Adapted(id_,
                          {result->updates_applied, result->adapter_distance, result->last_loss});
    }
    spdlog::debug("feedback {} taken, {} updates applied", result->sequence,
                  result->updates_applied);
    return result;
  }

 private:
  const std::string id_;
  const SessionRegistry::Lease session_;
  Telemetry* const telemetry_;
  TraceLog* const traces_;
};

SessionHost::Opened Describe(const OpenedSession& opened) {
  const Session& session = *opened.session;
  return {opened.id,
          opened.token,
          session.policy_spec(),
          session.durable(),
          session.spec().control_period_s,
          opened.session->Position()};
}

}  // namespace

absl::StatusOr<SessionHost::Opened> RegistryHost::Open(const Caller& caller,
                                                       const SessionSpec& spec,
                                                       const SessionScheduling& scheduling,
                                                       const GuardOptions* guard) {
  RS_ASSIGN_OR_RETURN(
      const OpenedSession opened,
      registry_->Open({spec, guard == nullptr ? guard_ : *guard, scheduling}, caller));
  return Describe(opened);
}

absl::StatusOr<SessionHost::Opened> RegistryHost::Resume(const Caller& caller,
                                                         const std::string& id,
                                                         const std::string& token) {
  RS_ASSIGN_OR_RETURN(const OpenedSession opened, registry_->Resume(id, token, caller));
  return Describe(opened);
}

absl::Status RegistryHost::Close(const Caller& caller, const std::string& id) {
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

absl::StatusOr<std::unique_ptr<SessionUse>> RegistryHost::Use(const Caller& caller,
                                                              const std::string& id) {
  RS_ASSIGN_OR_RETURN(SessionRegistry::Lease session, registry_->Use(id, caller));
  return std::make_unique<ShownUse>(id, std::move(session), telemetry_, traces_);
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
