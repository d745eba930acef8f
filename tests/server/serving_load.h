#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rpc/policy_client.h"
#include "server/wire/grpc/policy_service.h"

// Load on a policy server over the loopback, for measurements.
namespace robostress {

// What a policy of this spec may be asked about, with nothing to see.
Observation BlankObservation(const PolicySpec& spec);

// Of predictions, as their client sees them: from the request to the answer.
struct Latencies {
  std::vector<double> ms;
  double Quantile(double q) const;  // 0 without values
  void Append(const Latencies& other) { ms.insert(ms.end(), other.ms.begin(), other.ms.end()); }
};

struct LoadOptions {
  double seconds = 3;
  // Predictions of one client per second, at fixed times; 0: the next one as soon as the last one
  // was answered.
  double rate_hz = 0;
  bool feedback = true;  // five executed steps of each prediction are reported
};

struct LoadResult {
  Latencies latencies;
  double seconds = 0;
  double cpu_seconds = 0;  // of this process: server and clients
  uint64_t updates = 0;    // applied meanwhile
  double rate() const { return static_cast<double>(latencies.ms.size()) / seconds; }
};

// Sessions of one server, in async mode, each driven by a thread of its own.
class Clients {
 public:
  // `overrides` of method ours.
  static absl::StatusOr<Clients> Connect(const PolicyServer& server, const std::string& policy,
                                         int count, const std::vector<std::string>& overrides);
  // Everything fails with the first error.
  absl::StatusOr<LoadResult> Run(const LoadOptions& options);
  // Waits until nothing is learnt any more, so that it does not run on beside the next load.
  absl::Status Settle();

 private:
  absl::StatusOr<uint64_t> Updates();

  struct Client;
  std::vector<std::shared_ptr<Client>> clients_;
};

// "2 cores, load average 0.51 0.40 0.32"
std::string MachineNow();

}  // namespace robostress
