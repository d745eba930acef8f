#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <vector>

#include "calibration/search/signatures.h"

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

// Calls `use` with batches of surrogates [rows, count] from number `first` on, several at a time.
void ForSurrogates(const JointProblem& problem, const Screening& screening, const WindowSet& chosen,
                   int surrogates, uint64_t seed,
                   const std::function<void(int first, const Eigen::MatrixXd& drawn)>& use);

NullDistribution DrawNull(const JointProblem& problem, const Screening& screening,
                          const WindowSet& chosen, int surrogates, uint64_t seed);

}  // namespace robostress::calibration
