#include "robot_client/can/transmit_watch.h"

namespace robostress {

void TransmitWatch::Sent(const CanFrame& frame, bool echoes, int64_t now_ns) {
  if (!waits()) since_ns_ = now_ns;
  if (!echoes) return;
  if (count_ == kFrames) {
    first_ = (first_ + 1) % kFrames;
    --count_;
  }
  frames_[(first_ + count_++) % kFrames] = frame;
}

void TransmitWatch::Echoed(const CanFrame& frame) {
  for (size_t i = 0; i < count_; ++i) {
    if (frames_[(first_ + i) % kFrames] != frame) continue;
    first_ = (first_ + i + 1) % kFrames;
    count_ -= i + 1;
    return;
  }
}

void TransmitWatch::Look(bool queued) {
  if (!queued && !echoes_wait()) since_ns_ = kNothing;
}

}  // namespace robostress
