#include "robot_client/piper/joint_assembler.h"

#include <algorithm>

namespace robostress::piper {

std::optional<JointAssembler::Sample> JointAssembler::Add(const JointPair& pair, int64_t stamp_ns) {
  bool dropped = false;
  const bool repeated = slots_[pair.pair].has_value();
  for (std::optional<Slot>& slot : slots_) {
    if (slot && (repeated || stamp_ns - slot->stamp_ns > max_skew_ns_)) {
      slot.reset();
      dropped = true;
    }
  }
  torn_ += dropped ? 1 : 0;
  slots_[pair.pair] = Slot{pair, stamp_ns};
  if (!slots_[0] || !slots_[1] || !slots_[2]) return std::nullopt;
  Sample sample{{}, stamp_ns};
  for (std::optional<Slot>& slot : slots_) {
    sample.q[2 * slot->pair.pair] = slot->pair.first;
    sample.q[2 * slot->pair.pair + 1] = slot->pair.second;
    sample.stamp_ns = std::min(sample.stamp_ns, slot->stamp_ns);
    slot.reset();
  }
  return sample;
}

}  // namespace robostress::piper
