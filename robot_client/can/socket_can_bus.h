#pragma once

#include <string>
#include <vector>

#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/can/socket_calls.h"

namespace robostress {

// Standard identifiers that pass: those with (id & mask) == (filter.id & mask).
struct CanFilter {
  uint16_t id = 0;
  uint16_t mask = 0x7FF;
};

struct SocketCanOptions {
  std::string interface = "can0";
  // Identifiers that the kernel hands over; empty: all of them.
  std::vector<CanFilter> filters;
  int64_t reopen_interval_ns = 200'000'000;  // between attempts after the interface went down
};

// A real bus: a raw CAN socket of the kernel. The interface is brought up and given its bit rate by
// the system (robot_client/README.md). The controller's error frames set health().state; bus-off is
// left when the controller says that it restarted, or with the next frame that arrives. When the
// interface goes down or its adapter is unplugged, Send and Receive try to reopen it, no more often
// than reopen_interval_ns. Own frames do not come back: loopback is left on for other programs
// (candump), receiving own ones is off.
class SocketCanBus : public CanBus {
 public:
  // `clock` (the machine's monotonic one) and `calls` outlive the bus.
  SocketCanBus(SocketCanOptions options, const Clock& clock,
               SocketCalls& calls = SystemSocketCalls());
  ~SocketCanBus() override;
  SocketCanBus(const SocketCanBus&) = delete;
  SocketCanBus& operator=(const SocketCanBus&) = delete;

  absl::Status Open() override;
  absl::Status Send(const CanFrame& frame) override;
  bool Receive(StampedFrame& frame) override;
  CanHealth health() const override { return health_; }
  std::string description() const override { return "can:" + options_.interface; }

 private:
  // What failed, for Open's message; null when everything went well. Allocates nothing.
  const char* TryOpen();
  void ReopenWhenDue();
  void GoDown();
  void TakeErrorFrame(uint32_t error_class, const uint8_t (&data)[8]);
  template <class T>
  bool Set(int level, int option, const T& value);

  const SocketCanOptions options_;
  const Clock& clock_;
  SocketCalls& calls_;
  int socket_ = -1;  // file descriptor
  int64_t next_attempt_ns_ = 0;
  uint64_t overflows_before_ = 0;  // of sockets that were closed
  CanHealth health_;
};

}  // namespace robostress
