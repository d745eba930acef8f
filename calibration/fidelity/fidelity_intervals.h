#pragma once

#include <cstdint>

#include "calibration/fidelity/fidelity_study.h"

namespace robostress::calibration {

// Fills the estimates of `result` from its profiles: the distance of every contender's mean profile
// to the measured mean profile, and the rises. Intervals are percentiles of a bootstrap that draws
// layouts and measured loaded replays anew (Efron & Tibshirani, ch. 13), the same layouts for every
// contender; ends are NaN where one layout supports none. With three measured replays their share
// of an interval is coarse.
void AddIntervals(int replicates, int64_t seed, FidelityResult& result);

}  // namespace robostress::calibration
