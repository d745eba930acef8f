#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/can/can_bus.h"

namespace robostress {

// A bus by its address, not opened yet:
//   can:can0                       SocketCAN
//   udp:239.74.163.2:43113         multicast on this machine, python-can's framing
//   udp:239.74.163.2:43113%eth1    the same on a network
// `clock` is the machine's monotonic one and outlives the bus.
absl::StatusOr<std::unique_ptr<CanBus>> MakeCanBus(const std::string& address, const Clock& clock);

}  // namespace robostress
