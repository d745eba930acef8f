#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "common/random.h"
#include "common/remote_options.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/policy_conversation.h"

namespace robostress {

// INVALID_ARGUMENT names field, value and limit.
absl::Status CheckRemotePolicy(const RemotePolicyOptions& options);

struct RemotePolicyConnection {
  OpenpiConnectionOptions wire;
  // A server may compile its network when it is first asked: tens of seconds. So it may after every
  // connection, behind which it may have started anew.
  absl::Duration first_answer_timeout = absl::Minutes(5);
  absl::Duration answer_timeout = absl::Seconds(30);
  // How long a server may be gone that was there before, from the moment at which that was seen.
  absl::Duration absence = absl::Minutes(2);
};

// A policy behind openpi's wire or a relative of it. One thread. It learns nothing: feedback is
// counted and goes nowhere. A connection that breaks, or that the server closes, is dialled anew
// and the same question, with the same noise, is asked again. A server that holds a connection and
// says nothing is asked once more, on another connection.
class RemotePolicy : public PolicyEndpoint {
 public:
  // `url` without a path gets the dialect's. setting.policy is the user's label of the model;
  // `noise_stream`: MethodOptions'. Errors as OpenpiConnection::Connect's; INVALID_ARGUMENT where
  // the server's metadata say other sizes than `options`.
  static absl::StatusOr<std::unique_ptr<RemotePolicy>> Connect(
      const std::string& url, const RemotePolicyOptions& options, const SessionSetting& setting,
      const std::string& noise_stream = "policy", const RemotePolicyConnection& connection = {});

  // model_hash is the SHA-256 of label and metadata, without what changes from one connection to
  // the next: two models of one label and equal metadata look alike. The horizon is execute_steps
  // until the first answer came.
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey& key) override;
  // UNAVAILABLE where the server does not come back; INVALID_ARGUMENT or INTERNAL, at once, where
  // it answers what cannot be used: that does not change by asking again. FAILED_PRECONDITION
  // where it comes back and wishes for other views or steps: it is another model.
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override;
  absl::Status SendFeedback(ExecutedChunk executed) override;
  absl::StatusOr<SessionStats> Stats() override { return stats_; }

  const std::string& address() const { return connection_->address(); }
  std::string metadata() const;  // as JSON
  bool metadata_changed() const { return metadata_changed_; }
  // Whether equal keys of an episode give equal sampling noise: the dialect has a way to say it,
  // and the server does not say that it takes none.
  bool pairs_noise() const;
  int reconnections() const { return reconnections_; }

 private:
  RemotePolicy(std::string url, const RemotePolicyOptions& options, const SessionSetting& setting,
               std::string noise_stream, const RemotePolicyConnection& connection);
  absl::Status Dial();
  using Monotonic = std::chrono::steady_clock;  // nobody sets it

  // Dials until `gone`.
  absl::Status DialAgain(Monotonic::time_point gone, const absl::Status& lost);
  // Holds what the server says of itself against what is asked of it; `spec` becomes what it
  // wishes.
  absl::Status CheckMetadata(PolicySpec& spec);
  std::string StableMetadata() const;
  // What a server of ours says of its policy stands above the options.
  static void Adopt(const OpenpiValue& declared, PolicySpec& spec);
  // What answers `message`, by another connection where the present one is gone.
  absl::StatusOr<OpenpiValue> Ask(const std::function<absl::StatusOr<std::string>()>& message);
  absl::Status AtServer(const absl::Status& failed) const;  // with its address, and what to do
  std::vector<std::pair<std::string, std::string>> Extras(int chunk) const;
  std::string SessionText() const;
  StreamKey NoiseKey(int chunk) const;

  const std::string url_, noise_stream_;
  const RemotePolicyOptions options_;
  const SessionSetting setting_;
  const RemotePolicyConnection connection_options_;
  PolicySpec asked_, spec_;  // before any server said what it wishes; since one did
  std::unique_ptr<PolicyConversation> connection_;
  std::string metadata_hash_, session_name_;
  std::set<std::string> volatile_;  // JSON pointers into metadata that change without a reason
  EpisodeKey episode_;
  bool episode_open_ = false, episode_begins_ = false, connection_begins_ = false;
  bool metadata_changed_ = false, takes_seed_ = false;
  bool answered_ = false, answered_here_ = false;  // a prediction, ever and on this connection
  int reconnections_ = 0;
  int silences_ = 0;  // answers missed since one came in time
  uint64_t predictions_ = 0;
  SessionStats stats_;
};

}  // namespace robostress
