#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "server/operations/access_tokens.h"

namespace robostress {

// The sessions of a policy server as an endpoint sees them: what PolicyService does, without gRPC
// and without LibTorch. The same limits, order and errors. A session belongs to the caller that
// opened it; another one's call is PERMISSION_DENIED. Scopes are the wire's to ask for. Any thread.
class SessionHost {
 public:
  struct Opened {
    std::string id;
    std::string resume_token;  // a secret
    PolicySpec policy;
    bool durable = false;  // acknowledged feedback survives the server
  };
  struct Resumed {
    PolicySpec policy;
    bool durable = false;
    uint64_t feedback_sequence = 0;     // watermark
    std::optional<EpisodeKey> episode;  // the one that is open
    int next_chunk = 0;                 // after the last that was predicted in it
    double control_period_s = 0.05;     // of the session's spec [s]
  };
  // A prediction that may still be reported, whichever connection it was made for.
  struct Recalled {
    EpisodeKey episode;
    int chunk = 0;
    PredictedChunk prediction;
  };
  struct Acknowledged {
    uint64_t sequence = 0;  // watermark
    uint64_t updates_applied = 0;
    bool durable = false;
    bool duplicate = false;
  };

  virtual ~SessionHost() = default;
  virtual std::vector<PolicySpec> policies() const = 0;
  virtual absl::StatusOr<Opened> OpenSession(const Caller& caller, const SessionSpec& spec) = 0;
  virtual absl::StatusOr<Resumed> ResumeSession(const Caller& caller, const std::string& id,
                                                const std::string& token) = 0;
  virtual absl::Status CloseSession(const Caller& caller, const std::string& id) = 0;
  // A connection serves the session from now on; Detach says that it is gone. A session that no
  // connection serves is the first to make room for a new one. Both may be called for a session
  // that is gone.
  virtual void Attach(const std::string& id) = 0;
  virtual void Detach(const std::string& id) = 0;
  virtual absl::Status StartEpisode(const Caller& caller, const std::string& id,
                                    const EpisodeKey& key, uint64_t last_sequence) = 0;
  virtual absl::StatusOr<PredictedChunk> Predict(const Caller& caller, const std::string& id,
                                                 const Observation& observation,
                                                 const EpisodeKey& key, int chunk,
                                                 uint64_t last_sequence) = 0;
  // `prediction_id` 0: the newest. FAILED_PRECONDITION: the session does not hold it.
  virtual absl::StatusOr<Recalled> Recall(const Caller& caller, const std::string& id,
                                          uint64_t prediction_id) = 0;
  // The acknowledgement of feedback that is in already, which counts as a duplicate; nullopt: it is
  // not in.
  virtual absl::StatusOr<std::optional<Acknowledged>> Repeated(const Caller& caller,
                                                               const std::string& id,
                                                               uint64_t sequence) = 0;
  virtual absl::StatusOr<Acknowledged> Feedback(const Caller& caller, const std::string& id,
                                                const ExecutedChunk& executed) = 0;
};

}  // namespace robostress
