#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// A policy server that a worker may use.
struct ServerPlace {
  std::string address;  // HOST:PORT
  std::string machine;  // ProcessorKind::Text(), or "unknown"
};

// Where the workers of a pool find the servers of policies.
class ServerSource {
 public:
  virtual ~ServerSource() = default;
  // Of a policy; may wait. Unavailable: there is none; Cancelled: a signal came meanwhile.
  virtual absl::StatusOr<ServerPlace> Find(const std::string& policy) = 0;
  // An error when a server that this process owns has ended; the pool then stops.
  virtual absl::Status Check() = 0;
  // Asked when a worker of `policy` failed at `place`: true when the server is no longer there, so
  // that the failure says nothing about the unit.
  virtual bool Lost(const std::string& policy, const ServerPlace& place) = 0;
  // Descriptors that become readable when Check has news.
  virtual std::vector<int> wake_fds() const = 0;
};

}  // namespace robostress
