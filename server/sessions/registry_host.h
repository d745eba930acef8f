#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "server/operations/span_trace.h"
#include "server/operations/telemetry.h"
#include "server/sessions/session_host.h"
#include "server/sessions/session_registry.h"

namespace robostress {

// What every wire does with a session, in one place: finds it, calls it, and shows it to metrics,
// traces, logs and the live page. Any thread.
class RegistryHost : public SessionHost {
 public:
  // Everything must outlive it. `guard`: of sessions that ask for none.
  RegistryHost(SessionRegistry* registry, std::vector<PolicySpec> policies,
               const GuardOptions& guard, Telemetry* telemetry, TraceLog* traces)
      : registry_(registry),
        policies_(std::move(policies)),
        guard_(guard),
        telemetry_(telemetry),
        traces_(traces) {}

  std::vector<PolicySpec> policies() const override { return policies_; }
  absl::StatusOr<Opened> OpenSession(const Caller& caller, const SessionSpec& spec) override;
  absl::StatusOr<Resumed> ResumeSession(const Caller& caller, const std::string& id,
                                        const std::string& token) override;
  absl::Status CloseSession(const Caller& caller, const std::string& id) override;
  void Attach(const std::string& id) override;
  void Detach(const std::string& id) override;
  absl::Status StartEpisode(const Caller& caller, const std::string& id, const EpisodeKey& key,
                            uint64_t last_sequence) override;
  absl::StatusOr<PredictedChunk> Predict(const Caller& caller, const std::string& id,
                                         const Observation& observation, const EpisodeKey& key,
                                         int chunk, uint64_t last_sequence) override;
  absl::StatusOr<Recalled> Recall(const Caller& caller, const std::string& id,
                                  uint64_t prediction_id) override;
  absl::StatusOr<std::optional<Acknowledged>> Repeated(const Caller& caller, const std::string& id,
                                                       uint64_t sequence) override;
  absl::StatusOr<Acknowledged> Feedback(const Caller& caller, const std::string& id,
                                        const ExecutedChunk& executed) override;

  // With a priority and a deadline other than the session's. `received`: when the message came in;
  // what passed since then is the trace's stage "decode".
  absl::StatusOr<PredictedChunk> Predict(const Caller& caller, const std::string& id,
                                         const Observation& observation, const EpisodeKey& key,
                                         int chunk, uint64_t last_sequence, PredictOptions options,
                                         std::chrono::steady_clock::time_point received);
  // Every session as it stands.
  std::vector<SessionFigures> Figures() const;

 private:
  SessionRegistry* const registry_;
  const std::vector<PolicySpec> policies_;
  const GuardOptions guard_;
  Telemetry* const telemetry_;
  TraceLog* const traces_;
};

}  // namespace robostress
