#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "calibration/signatures.h"

namespace robostress::calibration {

// What gains chance alone would give: the same screening of residuals that have the same spectrum,
// track by track, and no relation to the motion (random phases, Theiler et al. 1992).
struct NullDistribution {
  std::vector<double> largest;                    // [surrogates] over the library
  std::vector<std::vector<double>> of_candidate;  // [candidates][surrogates]
  double Quantile(double share) const;            // of `largest`
  // (1 + surrogates that reach `gain`) / (1 + surrogates).
  double PValue(double gain) const;
  double PValueOf(int candidate, double gain) const;
};

NullDistribution DrawNull(const JointProblem& problem, const Screening& screening,
                          const WindowSet& chosen, int surrogates, uint64_t seed);

}  // namespace robostress::calibration
