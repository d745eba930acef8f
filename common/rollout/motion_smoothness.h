#pragma once

#include <vector>

#include "common/types.h"

namespace robostress {

// How smoothly an arm moved in one episode.
struct MotionSmoothness {
  // Mean over control steps of |p_(t+3) - 3 p_(t+2) + 3 p_(t+1) - p_t| / T^3 of the measured tool
  // position [m/s^3]; 0 in fewer than four states.
  double jerk = 0;
  // Mean over chunks after the first of |c_t - c_(t-1)|, t the first step that the chunk commanded,
  // c the sent command without its gripper [command units]; 0 where there are none.
  double jump = 0;
};

// Of the reports of one episode in their order. Where a report does not begin in the state in
// which the one before it ended, no difference is taken over the gap. `control_period_s`: T.
MotionSmoothness SmoothnessOf(const std::vector<ExecutedChunk>& chunks, double control_period_s);

}  // namespace robostress
