#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/chunk_key.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "server/operations/access_tokens.h"
#include "server/sessions/session_types.h"

namespace robostress {

struct GuardOptions;

// A session for the time of one message: found, and its caller's rights looked at, once. While it
// is held the session is not idle. One thread.
class SessionUse {
 public:
  // A prediction that may still be reported, whichever connection it was made for.
  struct Recalled {
    ChunkKey key;
    PredictedChunk prediction;
  };

  virtual ~SessionUse() = default;
  virtual absl::Status StartEpisode(const EpisodeKey& key, uint64_t last_sequence) = 0;
  // `received`: when the message came in; what passed since then is the trace's stage "decode".
  virtual absl::StatusOr<PredictedChunk> Predict(
      std::shared_ptr<const Observation> observation, const ChunkKey& key, uint64_t last_sequence,
      PredictOptions options, std::chrono::steady_clock::time_point received) = 0;
  // `prediction_id` 0: the newest. FAILED_PRECONDITION: the session does not hold it.
  virtual absl::StatusOr<Recalled> Recall(uint64_t prediction_id) = 0;
  // The acknowledgement of feedback that is in already, which counts as a duplicate; nullopt: it is
  // not in.
  virtual std::optional<FeedbackResult> Repeated(uint64_t sequence) = 0;
  virtual absl::StatusOr<FeedbackResult> Feedback(const ExecutedChunk& executed) = 0;
};

// The sessions of a policy server as every wire sees them, without LibTorch. A session belongs to
// the caller that opened it; another one's call is PERMISSION_DENIED. Scopes are the wire's to ask
// for. Any thread.
class SessionHost {
 public:
  // A session that was opened or resumed.
  struct Opened {
    std::string id;
    std::string resume_token;  // a secret; empty of one that was resumed
    PolicySpec policy;
    bool durable = false;            // acknowledged feedback survives the server
    double control_period_s = 0.05;  // of the session's spec [s]
    SessionPosition at;              // where its client goes on
  };

  virtual ~SessionHost() = default;
  virtual std::vector<PolicySpec> policies() const = 0;
  // `guard` null: the server's own.
  virtual absl::StatusOr<Opened> Open(const Caller& caller, const SessionSpec& spec,
                                      const SessionScheduling& scheduling = {},
                                      const GuardOptions* guard = nullptr) = 0;
  virtual absl::StatusOr<Opened> Resume(const Caller& caller, const std::string& id,
                                        const std::string& token) = 0;
  virtual absl::Status Close(const Caller& caller, const std::string& id) = 0;
  // A connection serves the session from now on; Detach says that it is gone. A session that no
  // connection serves is the first to make room for a new one. Both may be called for a session
  // that is gone.
  virtual void Attach(const std::string& id) = 0;
  virtual void Detach(const std::string& id) = 0;
  virtual absl::StatusOr<std::unique_ptr<SessionUse>> Use(const Caller& caller,
                                                          const std::string& id) = 0;
};

}  // namespace robostress
