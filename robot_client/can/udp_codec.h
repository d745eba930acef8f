#pragma once

#include <cstddef>
#include <cstdint>

#include "absl/types/span.h"
#include "robot_client/can/can_frame.h"

// python-can's `udp_multicast` framing (can/interfaces/udp_multicast, versions 4.1 to 4.5): one
// datagram per frame, one MessagePack map with the eleven fields of a can.Message, in this order:
//   timestamp float64 [s], arbitration_id, is_extended_id, is_remote_frame, is_error_frame,
//   channel nil|str, dlc, data bin, is_fd, bitrate_switch, error_state_indicator.
namespace robostress {

// Longest datagram that is looked at, python-can's own receive buffer.
inline constexpr size_t kMaxUdpCanBytes = 4096;
// Bytes of an encoded frame with eight bytes of data and no channel.
inline constexpr size_t kUdpCanFrameBytes = 162;

// Writes `frame` to `out`; returns the bytes used. timestamp_s is informative: receivers put in
// their own. Allocates nothing.
size_t EncodeUdpCan(const CanFrame& frame, double timestamp_s, uint8_t (&out)[kUdpCanFrameBytes]);

// Reads a datagram of any origin. Keys may come in any order and may be missing where python-can
// has a default that is a classic data frame (is_extended_id has not: its default is true). False
// for everything else: another type, an unknown or repeated key, bytes left over, a length that
// differs from dlc, extended, remote, error or FD frames. Allocates nothing.
bool DecodeUdpCan(absl::Span<const uint8_t> datagram, CanFrame& frame);

}  // namespace robostress
