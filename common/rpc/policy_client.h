#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"

namespace robostress {

struct PolicyClientOptions {
  std::string address;            // HOST:PORT, or unix:PATH
  double connect_timeout_s = 20;  // [s] until the server must accept a connection
  double call_timeout_s = 300;  // [s] for any answer; a lockstep prediction may wait for an update
  // A server that is lost is waited for this long [s], the session resumed and the call repeated;
  // 0: the error is returned, and the next call tries to resume. Below 0: 30 s if the server keeps
  // sessions on disk, else 0.
  double reconnect_timeout_s = -1;
  int max_unacknowledged = 16;  // async only: executed chunks under way before SendFeedback waits;
                                // lockstep waits for every acknowledgement
  SessionScheduling scheduling;
};

// What resumes a session; the token is a secret.
struct SessionTicket {
  std::string session_id, token;
};

// What the server at an address holds; UNAVAILABLE names the address and how to start one.
absl::StatusOr<ServerInfo> GetServerInfo(const PolicyClientOptions& options);

// A policy behind gRPC: one session, one thread, a stream for predictions and one for feedback.
//
// Executed chunks are kept until the server acknowledges them. After a lost stream, connection or
// server the session is resumed with its token, and what is kept is sent again before anything
// else. NOT_FOUND: the server does not have the session any more.
class GrpcPolicyClient : public PolicyEndpoint {
 public:
  // Connects and opens a session.
  static absl::StatusOr<std::unique_ptr<GrpcPolicyClient>> Connect(
      const PolicyClientOptions& options, const RequestedSession& session);
  // Goes on with a session that another client, or an earlier run, has left. Feedback goes on after
  // last_feedback_sequence(); an episode is started before the next prediction.
  static absl::StatusOr<std::unique_ptr<GrpcPolicyClient>> Resume(
      const PolicyClientOptions& options, const SessionTicket& ticket, ExecutionMode mode);
  // Closes the session, if the server still answers and it was not left.
  ~GrpcPolicyClient() override;

  const PolicySpec& spec() const override;
  absl::Status StartEpisode(const EpisodeKey& key) override;
  // A refusal (common/rollout/refusal.h) leaves the stream as it is. Lockstep comes back on
  // overload as long as call_timeout_s allows; async returns it.
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override;
  // INVALID_ARGUMENT where `running` does not fit the policy.
  absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                              const RunningRows& running) override;
  // FAILED_PRECONDITION unless executed.sequence follows the last one. UNAVAILABLE,
  // DEADLINE_EXCEEDED, CANCELLED and RESOURCE_EXHAUSTED (the server's disk is full): the chunk is
  // kept and will be sent again. Another error: a chunk was refused for good and is dropped; those
  // after it take its number on. The server takes every sequence number once.
  absl::Status SendFeedback(ExecutedChunk executed) override;
  // After every chunk sent so far is acknowledged.
  absl::StatusOr<SessionStats> Stats() override;

  // The session's adaptation with every update due (lockstep).
  absl::StatusOr<AdapterState> ExportAdapter();
  // Continues from an exported state; feedback goes on from its sequence number, which is returned.
  absl::StatusOr<uint64_t> ImportAdapter(const std::string& safetensors);
  // Back to the LoRA of an earlier update. Returns the updates applied after it.
  absl::StatusOr<uint64_t> RollbackAdapter(uint64_t version);

  // Sequence number of the last executed chunk sent; 0 before the first.
  uint64_t last_feedback_sequence() const;
  uint64_t acknowledged_feedback_sequence() const;
  const std::string& session_id() const;
  // Sessions resumed after a loss.
  uint64_t resumes() const;
  // The session stays open when this client ends; whoever has the ticket resumes it.
  SessionTicket Leave();

 private:
  struct Impl;
  explicit GrpcPolicyClient(std::unique_ptr<Impl> impl);
  // `running` null: a prediction of its own.
  absl::StatusOr<PredictedChunk> AskFor(const Observation& observation, int chunk,
                                        const RunningRows* running);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
