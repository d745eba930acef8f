#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// Puts the three frames of one joint sample together. The arm sends them back to back, 5 ms apart
// from the next sample; when a frame is lost, frames of two samples must not be mixed. A sample is
// complete when all three pairs are there, none came twice, and their arrivals lie within max_skew;
// everything else is torn and dropped.
class JointAssembler {
 public:
  struct Sample {
    JointVector q;     // [rad]
    int64_t stamp_ns;  // of its oldest frame
  };

  explicit JointAssembler(int64_t max_skew_ns) : max_skew_ns_(max_skew_ns) {}

  // A sample when this frame completes one.
  std::optional<Sample> Add(const JointPair& pair, int64_t stamp_ns);
  uint64_t torn() const { return torn_; }

 private:
  struct Slot {
    JointPair pair;
    int64_t stamp_ns;
  };
  const int64_t max_skew_ns_;
  std::array<std::optional<Slot>, 3> slots_;
  uint64_t torn_ = 0;
};

}  // namespace robostress::piper
