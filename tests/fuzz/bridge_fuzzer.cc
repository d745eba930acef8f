// What a driver process may send: frames one after the other, and its welcome.
#include <array>
#include <cmath>
#include <cstring>
#include <string>

#include "robot_client/bridge/protocol.h"
#include "robot_client/bridge/robot_file.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  using namespace robostress::bridge;
  size_t at = 0;
  while (at < size) {
    FrameHeader header;
    if (DecodeHeader(data + at, size - at, header) != Decoded::kFrame) break;
    const uint8_t* payload = data + at + kHeaderBytes;
    FuzzCheck(at + kHeaderBytes + header.size <= size, "a frame beyond its bytes");
    for (int axes = 1; axes <= kMostAxes; ++axes) {
      StateFrame state;
      std::array<uint8_t, kMostFrame> again{};
      if (header.kind != FrameKind::kState ||
          DecodeState(payload, header.size, axes, state) != Decoded::kFrame)
        continue;
      for (const ArmVector* values : {&state.position, &state.velocity, &state.effort}) {
        for (const double value : *values)
          FuzzCheck(std::abs(value) <= kMostValue, "a value that is no number");
      }
      FuzzCheck(EncodeState(state, header.sequence, again) == kHeaderBytes + header.size &&
                    std::memcmp(again.data(), data + at, kHeaderBytes + header.size) == 0,
                "a state that does not come back");
    }
    if (header.kind == FrameKind::kWelcome) {
      const auto welcome = ParseWelcome({reinterpret_cast<const char*>(payload), header.size});
      FuzzCheck(welcome.ok() || !welcome.status().message().empty(), "a refusal without a reason");
      if (welcome.ok()) {
        FuzzCheck(welcome->watchdog_s >= 0 && welcome->watchdog_s <= 60, "a watchdog out of range");
        for (const char c : welcome->driver + welcome->robot + welcome->note)
          FuzzCheck(static_cast<unsigned char>(c) >= 32, "a control character for the terminal");
        Missing({}, *welcome);
      }
    }
    at += kHeaderBytes + header.size;
  }
  // The same bytes as a robot file.
  const auto robot = ParseBridgeRobot("arm.yaml", {reinterpret_cast<const char*>(data), size});
  if (!robot.ok()) {
    CheckRefusal(robot.status(), "arm.yaml");
    return 0;
  }
  FuzzCheck(robot->limits.axes.count() >= 1 && robot->limits.axes.count() <= kMostAxes,
            "too many axes");
  for (int i = 0; i < robot->limits.axes.count(); ++i) {
    const double there = robot->conversions[i].Ours(1);
    FuzzCheck(std::isfinite(there) && std::isfinite(robot->conversions[i].Drivers(there)),
              "a unit that is no number");
    FuzzCheck(robot->limits.lower[robot->limits.axes.slot(i)] <
                  robot->limits.upper[robot->limits.axes.slot(i)],
              "an axis without room");
  }
  return 0;
}
