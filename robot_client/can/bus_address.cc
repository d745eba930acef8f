#include "robot_client/can/bus_address.h"

#include <net/if.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/status_macros.h"
#include "robot_client/can/socket_can_bus.h"
#include "robot_client/can/udp_can_bus.h"

namespace robostress {

absl::StatusOr<std::unique_ptr<CanBus>> MakeCanBus(const std::string& address, const Clock& clock) {
  absl::string_view rest = address;
  if (absl::ConsumePrefix(&rest, "udp:")) {
    RS_ASSIGN_OR_RETURN(const UdpCanOptions options, ParseUdpCanOptions(std::string(rest)));
    return std::make_unique<UdpCanBus>(options, clock);
  }
  if (absl::ConsumePrefix(&rest, "can:")) {
    if (rest.empty() || rest.size() >= IFNAMSIZ)
      return absl::InvalidArgumentError(
          absl::StrCat("bus '", address, "': '", rest, "' is no interface name, as in can:can0"));
    SocketCanOptions options;
    options.interface = std::string(rest);
    return std::make_unique<SocketCanBus>(options, clock);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("bus '", address,
                   "': expected can:INTERFACE or udp:GROUP:PORT[%INTERFACE], as in "
                   "can:can0 or udp:239.74.163.2:43113"));
}

}  // namespace robostress
