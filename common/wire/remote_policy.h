#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/random.h"
#include "common/remote_options.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"
#include "common/wire/openpi_connection.h"

namespace robostress {

// INVALID_ARGUMENT names field, value and limit.
absl::Status CheckRemotePolicy(const RemotePolicyOptions& options);

// A policy behind openpi's wire or a relative of it. One thread. It learns nothing: feedback is
// counted and goes nowhere. A connection that breaks, or that the server closes, is dialled anew
// and the same question, with the same noise, is asked again.
class RemotePolicy : public PolicyEndpoint {
 public:
  // `url` without a path gets the dialect's. setting.policy is the user's label of the model;
  // `noise_stream`: MethodOptions'. Errors as OpenpiConnection::Connect's; INVALID_ARGUMENT where
  // the server's metadata say other sizes than `options`.
  static absl::StatusOr<std::unique_ptr<RemotePolicy>> Connect(
      const std::string& url, const RemotePolicyOptions& options, const SessionSetting& setting,
      const std::string& noise_stream = "policy", const OpenpiConnectionOptions& connection = {});

  // model_hash is the SHA-256 of label and metadata: two models of one label and equal metadata
  // look alike. The horizon is execute_steps until the first answer came.
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey& key) override;
  // UNAVAILABLE where the server does not come back; INVALID_ARGUMENT or INTERNAL, at once, where
  // it answers what cannot be used: that does not change by asking again.
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override;
  absl::Status SendFeedback(ExecutedChunk executed) override;
  absl::StatusOr<SessionStats> Stats() override { return stats_; }

  const std::string& address() const { return connection_->address(); }
  std::string metadata() const;  // as JSON
  bool metadata_changed() const { return metadata_changed_; }
  int reconnections() const { return reconnections_; }

 private:
  RemotePolicy(std::string url, const RemotePolicyOptions& options, const SessionSetting& setting,
               std::string noise_stream, const OpenpiConnectionOptions& connection);
  absl::Status Dial();
  absl::Status CheckMetadata();
  // What a server of ours says of its policy stands above the options.
  void Adopt(const OpenpiValue& declared);
  // The bytes that answer `message`, by another connection where the present one is gone.
  absl::StatusOr<std::string> Ask(const std::function<absl::StatusOr<std::string>()>& message);
  std::vector<std::pair<std::string, std::string>> Extras(int chunk) const;
  std::string SessionText() const;
  StreamKey NoiseKey(int chunk) const;

  const std::string url_, noise_stream_;
  const RemotePolicyOptions options_;
  const SessionSetting setting_;
  const OpenpiConnectionOptions connection_options_;
  PolicySpec spec_;
  std::unique_ptr<OpenpiConnection> connection_;
  std::string metadata_hash_, session_name_;
  EpisodeKey episode_;
  bool episode_open_ = false, episode_begins_ = false, connection_begins_ = false;
  bool metadata_changed_ = false, answered_ = false;
  int reconnections_ = 0;
  uint64_t predictions_ = 0;
  SessionStats stats_;
};

}  // namespace robostress
