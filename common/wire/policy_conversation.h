#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "common/remote_options.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/openpi_value.h"

namespace robostress {

// An episode that begins, for a server that is told of it.
struct EpisodeNotice {
  std::string suite;
  EpisodeKey key;
  std::string instruction;
};

// What is said to a policy server and in which order, beneath RemotePolicy: one connection. One
// thread. After an error it is finished; open another.
class PolicyConversation {
 public:
  // Keys of a message with values that an OpenpiWriter wrote.
  using Extras = std::vector<std::pair<std::string, std::string>>;

  // On the wire of `dialect`; returns when the server has greeted. Errors as
  // WebSocketClient::Connect's; FAILED_PRECONDITION where it greets as another wire's servers do.
  static absl::StatusOr<std::unique_ptr<PolicyConversation>> Open(
      const std::string& url, const OpenpiDialect& dialect, const OpenpiConnectionOptions& options);
  virtual ~PolicyConversation() = default;

  // What the server says of itself: a map. Valid as long as this.
  virtual const OpenpiValue& metadata() const = 0;
  virtual const std::string& address() const = 0;
  // Holds what the server wishes to see against what it will be shown; `spec` loses the cameras
  // that it does not wish for. INVALID_ARGUMENT names the wish that cannot be fulfilled.
  virtual absl::Status Agree(PolicySpec& /*spec*/) const { return absl::OkStatus(); }
  // The next question is the episode's first.
  virtual void BeginEpisode(const EpisodeNotice& /*episode*/) {}
  virtual void EndEpisode() {}
  // A question about the observation. Errors as WriteOpenpiObservation's.
  virtual absl::StatusOr<std::string> Write(const Observation& observation,
                                            const Extras& extras) const = 0;
  // Its answer, for ReadOpenpiAnswer; views in it are valid until the next call. INVALID_ARGUMENT
  // or INTERNAL for what is no answer, DEADLINE_EXCEEDED after `limit`, each with the address.
  virtual absl::StatusOr<OpenpiValue> Ask(std::string question, absl::Duration limit) = 0;
};

}  // namespace robostress
