#pragma once

#include <chrono>
#include <cstdint>
#include <list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "common/rollout/session_spec.h"

namespace robostress {

// No change of the time of day moves it.
using MonotonicTime = std::chrono::steady_clock::time_point;

struct RequestQueueOptions {
  int capacity = 256;  // predictions waiting; the next is refused, or takes a simulation's place
  // A simulation that has waited this long goes like a robot: real arms cannot starve it for ever.
  absl::Duration starvation_limit = absl::Seconds(2);
};

// One prediction that waits for a batch.
struct QueuedRequest {
  uint64_t session = 0;  // of the server's life
  Priority priority = Priority::kSimulation;
  // Async: a newer request of the session takes its place, because its observation is stale then.
  bool replaceable = false;
  const void* group = nullptr;  // equal: may share a batch
  bool alone = false;           // in a batch of its own
  MonotonicTime arrival;
  MonotonicTime deadline = MonotonicTime::max();
};

// The order in which predictions are computed. Robots before simulations, within a class the
// earliest deadline first, then the order of arrival. Bounded; not thread-safe: its owner locks.
// Every function that takes requests out returns them with the reason, so that nobody waits for an
// answer that does not come.
class RequestQueue {
 public:
  using Request = std::shared_ptr<QueuedRequest>;
  using Refused = std::vector<std::pair<Request, absl::Status>>;

  explicit RequestQueue(const RequestQueueOptions& options) : options_(options) {}

  // `request`, or others that it displaces, may be among the refused: an older replaceable one of
  // its session (ABORTED); where the queue is full the last simulation if it is a robot, otherwise
  // itself (RESOURCE_EXHAUSTED with `retry_after`).
  Refused Push(Request request, absl::Duration retry_after);
  // At most `most` of one group, in order; what cannot be done by its deadline within
  // `compute_time` is refused (DEADLINE_EXCEEDED).
  std::vector<Request> PopBatch(MonotonicTime now, int most, absl::Duration compute_time,
                                Refused& expired);
  // False if it is not waiting (any more).
  bool Remove(const QueuedRequest* request);
  // Everything of one session, or of all (0).
  std::vector<Request> RemoveSession(uint64_t session);

  int size() const { return static_cast<int>(waiting_.size()); }
  MonotonicTime oldest_arrival() const;  // max() when empty

 private:
  bool Before(const QueuedRequest& a, const QueuedRequest& b, MonotonicTime now) const;

  const RequestQueueOptions options_;
  std::list<Request> waiting_;  // in the order of arrival
};

}  // namespace robostress
