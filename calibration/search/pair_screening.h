#pragma once

#include <array>
#include <vector>

#include "calibration/search/signatures.h"

namespace robostress::calibration {

// Two candidates at once.
struct PairContender {
  std::array<int, 2> candidates{};  // of the screening
  Hypothesis start;                 // the model with both, amplitudes by linear least squares
  double gain = 0;                  // share of the residual's energy that they explain together
  double p = 1;  // of as large a gain by the best pair of the library, under the null
};

// The pairs whose signatures, each candidate's best one, explain most of a residual together;
// best first, kPairs at most, none that chance explains (p > 0.05). Pairs of one type of effect are
// left out. The null distribution is that of DrawNull.
inline constexpr int kPairs = 4;
std::vector<PairContender> ScreenPairs(const JointProblem& problem, const Screening& screening,
                                       const SignalScales& scales, const WindowSet& chosen,
                                       int surrogates, uint64_t seed);

}  // namespace robostress::calibration
