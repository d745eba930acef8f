#include "robot_client/can/can_bus.h"

namespace robostress {

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
