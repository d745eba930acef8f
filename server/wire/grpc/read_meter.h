#pragma once

#include <cstdint>
#include <string>
#include <unordered_map>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"

namespace robostress {

// What a connection has brought, beside what its messages may have.
//
// gRPC 1.51 holds a message until it is whole, however long it says it is, and only then compares
// it with a limit. So the kernel is asked how many bytes came over each TCP connection (tcp(7),
// TCP_INFO), and a connection whose calls wait for messages is over when it brought more than all
// of them may be long. Sockets of other kinds are not metered. Any thread.
class ReadMeter {
 public:
  // Beyond what the messages under way may be long: headers of calls, frames, pings [bytes].
  static constexpr uint64_t kSlack = 1 << 20;

  // A call of the connection waits for a message of at most `most` bytes. `peer` is gRPC's name of
  // it, "ipv4:127.0.0.1:5000".
  void Begin(const std::string& peer, size_t most) ABSL_LOCKS_EXCLUDED(mu_);
  // It waits no longer; a message of `bytes` came, or none (0).
  void End(const std::string& peer, size_t most, size_t bytes) ABSL_LOCKS_EXCLUDED(mu_);
  // Connections that are over now.
  std::vector<std::string> Over() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Connection {
    int reads = 0;
    uint64_t allowed = 0;  // of the reads
    uint64_t credit = 0;   // what was taken, and what came around it
    int descriptor = -1;   // -1: not found yet
    uint64_t base = 0;     // received when it was found
  };

  absl::Mutex mu_;
  std::unordered_map<std::string, Connection> connections_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
