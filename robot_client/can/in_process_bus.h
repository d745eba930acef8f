#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "absl/synchronization/mutex.h"
#include "common/clock.h"
#include "robot_client/can/can_bus.h"

namespace robostress {

// A bus inside one process: what one node sends, every other node receives in the same order,
// stamped with the bus's clock. With a manual clock, an arm in software and its client share
// simulated time.
class InProcessBus {
 public:
  // Frames that wait at a node; the oldest is lost, and counted as an overflow, when one more
  // comes.
  static constexpr size_t kQueue = 4096;

  explicit InProcessBus(const Clock& clock, std::string name = "in-process")
      : wire_(std::make_shared<Wire>(clock, std::move(name))) {}

  // A new node; it may outlive this object, not the clock.
  std::unique_ptr<CanBus> Attach();

 private:
  struct Inbox {
    std::array<StampedFrame, kQueue> frames;  // ring
    size_t first = 0, count = 0;
    uint64_t overflows = 0;
  };
  struct Wire {
    Wire(const Clock& c, std::string n) : clock(c), name(std::move(n)) {}
    const Clock& clock;
    const std::string name;
    absl::Mutex mutex;
    std::vector<Inbox*> inboxes ABSL_GUARDED_BY(mutex);  // of the open nodes
  };
  class Node;

  std::shared_ptr<Wire> wire_;
};

}  // namespace robostress
