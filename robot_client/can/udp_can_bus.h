#pragma once

#include <netinet/in.h>

#include <array>
#include <string>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/can/udp_codec.h"

namespace robostress {

struct UdpCanOptions {
  std::string group = "239.74.163.2";  // IPv4 multicast group: python-can's default
  // One port per arm. Groups on one port leak into receivers that bind no group, as python-can's.
  int port = 43113;
  // Interface by name. The default keeps every frame on this machine; naming another one opens the
  // arm to whoever is on that network.
  std::string interface = "lo";
};

// "239.74.163.2:43113", or with an interface "239.74.163.2:43113%eth1".
absl::StatusOr<UdpCanOptions> ParseUdpCanOptions(const std::string& text);

// CAN frames as multicast datagrams in python-can's framing (udp_codec.h). Multicast gives a sender
// its own frames back: they are told by the address and port of the sending socket, which belongs
// to this object alone, and dropped. Arrival stamps are the kernel's.
class UdpCanBus : public CanBus {
 public:
  // `clock` must be the machine's monotonic one and outlive the bus.
  UdpCanBus(UdpCanOptions options, const Clock& clock);
  ~UdpCanBus() override;
  UdpCanBus(const UdpCanBus&) = delete;
  UdpCanBus& operator=(const UdpCanBus&) = delete;

  absl::Status Open() override;
  absl::Status Send(const CanFrame& frame) override;
  bool Receive(StampedFrame& frame) override;
  CanHealth health() const override { return health_; }
  std::string description() const override;

 private:
  absl::Status OpenReceiver(int interface_index);
  absl::Status OpenSender(int interface_index);
  absl::Status Failure(const std::string& what, const std::string& remedy) const;
  void Close();

  const UdpCanOptions options_;
  const Clock& clock_;
  int receiver_ = -1, sender_ = -1;  // file descriptors
  sockaddr_in own_{};                // of sender_
  std::array<uint8_t, kMaxUdpCanBytes + 1> buffer_;
  CanHealth health_;
};

}  // namespace robostress
