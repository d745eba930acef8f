#pragma once

#include <array>
#include <cstdint>

namespace robostress {

inline constexpr uint16_t kMaxCanId = 0x7FF;  // standard, 11 bits

// A classic CAN 2.0 data frame with a standard identifier: the only kind a Piper speaks.
struct CanFrame {
  uint16_t id = 0;                // 0 .. kMaxCanId
  uint8_t size = 8;               // bytes used of data, 0 .. 8
  std::array<uint8_t, 8> data{};  // unused bytes are zero

  bool operator==(const CanFrame&) const = default;
};

struct StampedFrame {
  CanFrame frame;
  int64_t stamp_ns = 0;  // of its arrival at this machine, on the bus's Clock
};

}  // namespace robostress
