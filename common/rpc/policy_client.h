#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rpc/session_spec.h"

namespace robostress {

struct PolicyClientOptions {
  std::string address;            // HOST:PORT, or unix:PATH
  double connect_timeout_s = 20;  // [s] until the server must accept a connection
  double call_timeout_s = 300;  // [s] for any answer; a lockstep prediction may wait for an update
  int max_unacknowledged = 16;  // async only: executed chunks under way before SendFeedback waits;
                                // lockstep waits for every acknowledgement
};

// What the server at an address holds; UNAVAILABLE names the address and how to start one.
absl::StatusOr<ServerInfo> GetServerInfo(const PolicyClientOptions& options);

// A policy behind gRPC: one session, one thread, a stream for predictions and one for feedback.
class GrpcPolicyClient : public PolicyEndpoint {
 public:
  // Connects and opens a session.
  static absl::StatusOr<std::unique_ptr<GrpcPolicyClient>> Connect(
      const PolicyClientOptions& options, const SessionSpec& session);
  // Closes the session, if the server still answers.
  ~GrpcPolicyClient() override;

  const PolicySpec& spec() const override;
  absl::Status StartEpisode(const EpisodeKey& key) override;
  // A refusal (common/rpc/refusal.h) leaves the stream as it is. Lockstep comes back on overload as
  // long as call_timeout_s allows; async returns it.
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override;
  // FAILED_PRECONDITION unless executed.sequence follows the last one. Async: a chunk is kept until it
  // is acknowledged; UNAVAILABLE, DEADLINE_EXCEEDED and CANCELLED say that the stream is lost, the
  // chunk is kept, and the next call sends what is kept again on a new stream. The server takes every
  // sequence number once.
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

 private:
  struct Impl;
  explicit GrpcPolicyClient(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
