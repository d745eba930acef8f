#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/can/interface_restart.h"
#include "robot_client/can/socket_calls.h"
#include "robot_client/can/transmit_watch.h"

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
  // Send refuses while a frame has waited for the bus this long: under one period of 30 Hz, so that
  // of a stalled adapter's commands one period's waits and none piles up to be obeyed late.
  int64_t stall_ns = 20'000'000;
  int64_t probe_interval_ns = 100'000'000;  // a stalled bus is tried with one frame this often
  // A bus-off that the device has not ended by itself after this long (deploy/can0.sh sets
  // restart-ms 100 where the device has it) is ended by taking the interface down and up; again
  // after the same time while it lasts.
  int64_t bus_off_wait_ns = 500'000'000;
};

// A real bus: a raw CAN socket of the kernel. The interface is brought up and given its bit rate by
// the system (deploy/can0.sh). The controller's error frames set health().state; bus-off is left
// when the controller says that it restarted, with the next frame of another node, or by
// InterfaceRestart, where the program has CAP_NET_ADMIN. When the interface goes down or its
// adapter is unplugged, Send and Receive try to reopen it, no more often than reopen_interval_ns.
// Own frames come back from the kernel once the device has sent them; they are not handed out, but
// tell a stalled device (transmit_watch.h).
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
  CanHealth health() const override;
  std::string description() const override { return "can:" + options_.interface; }

 private:
  // What failed and what to do, for Open's message. Allocates nothing.
  struct Failure {
    const char* what;
    const char* remedy;  // $0: the interface
  };
  std::optional<Failure> TryOpen();
  bool IsDown();
  bool SetFilters();
  bool ComesBack(const CanFrame& frame) const;
  int64_t QueuedBytes();
  bool Stalled();
  void ReopenWhenDue();
  void GoDown();
  void GoBusOff();
  void LeaveBusOff();
  void TakeRestartResult();
  void EndBusOffWhenDue();
  void TakeErrorFrame(uint32_t error_class, const uint8_t (&data)[8]);
  template <class T>
  bool Set(int level, int option, const T& value);

  const SocketCanOptions options_;
  const Clock& clock_;
  SocketCalls& calls_;
  int socket_ = -1;  // file descriptor
  int64_t next_attempt_ns_ = 0;
  uint64_t overflows_before_ = 0;  // of sockets that were closed
  int64_t restart_due_ns_ = 0;     // while bus-off
  bool restart_asked_ = false;     // its result is not taken yet
  int64_t next_probe_ns_ = 0;      // while stalled
  TransmitWatch transmit_;
  std::unique_ptr<InterfaceRestart> restart_;  // from Open on
  CanHealth health_;
};

}  // namespace robostress
