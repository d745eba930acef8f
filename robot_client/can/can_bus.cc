#include "robot_client/can/can_bus.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"

namespace robostress {
namespace {

// A wait that a person should hear of; commands are refused from SocketCanOptions::stall_ns on.
constexpr int64_t kLongWait_ns = 100'000'000;

std::string BusOffAdvice(const std::string& interface, CanRestart restart) {
  const std::string down_and_up = absl::StrCat(
      "`sudo ip link set ", interface, " down && sudo ip link set ", interface,
      " up` (a slow cure for a wrong cable, terminator or bit rate: look there first)");
  switch (restart) {
    case CanRestart::kNone:
      return absl::StrCat("interface ", interface,
                          " is bus-off: its controller has left the bus after too many errors and "
                          "may return by itself; check cable, terminators and bit rate (1 Mbit/s)");
    case CanRestart::kDone:
      return absl::StrCat("interface ", interface,
                          " is bus-off and its device does not restart by itself; it was taken "
                          "down and up; check cable, terminators and bit rate (1 Mbit/s)");
    case CanRestart::kNoRights:
      return absl::StrCat("interface ", interface,
                          " is bus-off, its device does not restart by itself, and this program "
                          "may not take it down and up (CAP_NET_ADMIN); type ",
                          down_and_up);
    case CanRestart::kFailed:
      return absl::StrCat("interface ", interface,
                          " is bus-off, its device does not restart by itself, and the kernel "
                          "refused to take it down and up; unplug the adapter and plug it in, "
                          "then type `sudo ./deploy/can0.sh ",
                          interface, "`");
  }
  return "";
}

}  // namespace

std::string BusAdvice(const std::string& description, const CanHealth& health) {
  const std::string interface(absl::StripPrefix(description, "can:"));
  switch (health.state) {
    case CanState::kClosed:
      return "";
    case CanState::kDown:
      return absl::StrCat("interface ", interface,
                          " is down or gone; plug the adapter in and type `sudo "
                          "./deploy/can0.sh ",
                          interface, "`; the bus reopens by itself");
    case CanState::kBusOff:
      return BusOffAdvice(interface, health.restart);
    case CanState::kActive:
    case CanState::kPassive:
      break;
  }
  if (health.transmit_wait_ns >= kLongWait_ns)
    return absl::StrFormat(
        "interface %s has sent nothing for %.1f s although frames wait: the adapter hangs, or "
        "nobody on the bus acknowledges; check the arm's power and the cable, then unplug the "
        "adapter and plug it in",
        interface, 1e-9 * static_cast<double>(health.transmit_wait_ns));
  if (health.state == CanState::kPassive)
    return absl::StrCat("interface ", interface,
                        " is error-passive: check cable, terminators and bit rate (1 Mbit/s)");
  return "";
}

const char* CanStateName(CanState state) {
  switch (state) {
    case CanState::kClosed:
      return "closed";
    case CanState::kActive:
      return "active";
    case CanState::kPassive:
      return "error-passive";
    case CanState::kBusOff:
      return "bus-off";
    case CanState::kDown:
      return "down";
  }
  return "";
}

}  // namespace robostress
