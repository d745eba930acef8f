#pragma once

#include <sys/socket.h>

#include <cstdint>
#include <optional>

namespace robostress {

// What the kernel says beside a datagram of a socket with SO_TIMESTAMPNS and SO_RXQ_OVFL.
struct Arrival {
  int64_t stamp_ns = 0;               // CLOCK_MONOTONIC
  std::optional<uint32_t> overflows;  // datagrams that this socket has lost so far
};

// now_ns: CLOCK_MONOTONIC. The kernel stamps with the wall clock; only the datagram's age, at most
// kMaxQueueAge_ns, is taken from it, so that a step of the wall clock cannot make a frame older
// than that, nor younger than now. Without a stamp: now.
inline constexpr int64_t kMaxQueueAge_ns = 200'000'000;
Arrival ReadArrival(const msghdr& message, int64_t now_ns);

}  // namespace robostress
