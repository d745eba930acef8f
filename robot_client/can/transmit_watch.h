#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "robot_client/can/can_frame.h"

namespace robostress {

// Which frames of ours still wait for the bus. A frame is sent when its echo comes back: a device
// that reports what it sent (IFF_ECHO: gs_usb and most others) gives the echo then. For one that
// does not (slcan, vcan) the kernel gives it at once; there the bytes that the kernel still holds
// for the socket tell (SO_MEMINFO). Both together are asked here. Holds at most kFrames frames.
class TransmitWatch {
 public:
  static constexpr size_t kFrames = 256;

  void Clear() { first_ = count_ = 0, since_ns_ = kNothing; }
  // After the kernel took the frame; `echoes`: whether it will come back.
  void Sent(const CanFrame& frame, bool echoes, int64_t now_ns);
  // Expects no echo any more of what was sent so far, but still knows since when something waits.
  void ForgetFrames() { count_ = 0; }
  // An echo: echoes come in the order of sending, so that frames before it whose echo was lost
  // count as sent too.
  void Echoed(const CanFrame& frame);
  bool echoes_wait() const { return count_ > 0; }
  // `queued`: the kernel still holds frames of ours.
  void Look(bool queued);
  bool waits() const { return since_ns_ != kNothing; }
  // For how long something of ours has been waiting without a break; 0 when nothing waits.
  int64_t wait_ns(int64_t now_ns) const { return waits() ? now_ns - since_ns_ : 0; }

 private:
  static constexpr int64_t kNothing = -1;
  std::array<CanFrame, kFrames> frames_;
  size_t first_ = 0, count_ = 0;
  int64_t since_ns_ = kNothing;
};

}  // namespace robostress
