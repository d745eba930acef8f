#pragma once

#include "common/latency_options.h"

namespace robostress {

// LatencyOptions in control steps.
struct LatePlay {
  int delay_steps = 0;  // an answer to step k is there at step k + delay_steps; 0: none is late
  LateChunks mode = LateChunks::kSwitch;
  int late_steps = 10, fade_steps = 4;
  int guide_rows = 0;
  double moved_bound = 0.1;
};

// delay_steps = ceil(ms / period).
LatePlay LatePlayOf(const LatencyOptions& options, double control_period_s);

}  // namespace robostress
