#pragma once

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "robot_client/can/can_frame.h"

namespace robostress {

enum class CanState {
  kClosed,   // Open has not succeeded yet
  kActive,   // frames go both ways
  kPassive,  // the controller counts many errors: a cable, a terminator, a wrong bit rate
  kBusOff,   // the controller has left the bus
  kDown,     // the interface is down or gone; reopening is tried
};
const char* CanStateName(CanState state);

// What became of taking a bus-off interface down and up, which is tried when its device does not
// end the bus-off by itself.
enum class CanRestart {
  kNone,      // not tried since the last bus-off
  kDone,      // the interface was taken down and up
  kNoRights,  // needs CAP_NET_ADMIN: a person must type it
  kFailed,    // the kernel refused
};

// Counts since Open.
struct CanHealth {
  CanState state = CanState::kClosed;
  uint64_t sent = 0;
  uint64_t received = 0;       // frames handed out
  uint64_t own_echoes = 0;     // own frames that the transport gave back; dropped
  uint64_t refused = 0;        // what arrived and is no CAN 2.0 data frame; dropped
  uint64_t send_failures = 0;  // transmit queue full or stalled, interface down, bus-off
  uint64_t stalled_sends = 0;  // of these: refused because earlier frames still waited for the bus
  uint64_t overflows = 0;      // frames lost because nobody received them in time
  uint64_t error_frames = 0;   // reported by the controller
  uint64_t reopened = 0;       // times the interface came back
  uint64_t bus_offs = 0;
  CanRestart restart = CanRestart::kNone;
  int64_t transmit_wait_ns =
      0;  // for how long frames of ours have waited for the bus; 0: none does
};

// What a person should know and type about a bus in this state, in sentences that name it; empty
// while nothing is wrong. `description`: CanBus::description().
std::string BusAdvice(const std::string& description, const CanHealth& health);

// One node of a CAN bus. A node never receives its own frames. One thread at a time; nothing here
// starts a thread. Send, Receive and health never block and never allocate, so that they may be
// called from a control loop: their errors carry a code and no text, health() says the rest.
class CanBus {
 public:
  virtual ~CanBus() = default;

  // The error names the bus, the cause and the remedy. Opening an open bus does nothing.
  virtual absl::Status Open() = 0;
  // kResourceExhausted: the transmit queue is full or stalled; kUnavailable: closed, bus-off or
  // down.
  virtual absl::Status Send(const CanFrame& frame) = 0;
  // The next frame that has arrived, oldest first; false when none waits.
  virtual bool Receive(StampedFrame& frame) = 0;
  virtual CanHealth health() const = 0;
  virtual std::string description() const = 0;  // "udp:239.74.163.2:43113", "can:can0"
};

}  // namespace robostress
