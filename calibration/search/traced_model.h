#pragma once

#include <string>
#include <vector>

#include "calibration/search/cross_validation.h"

namespace robostress::calibration {

// One joint's model with effects that were added, fitted and cross-validated.
struct TracedModel {
  std::vector<std::string> added;  // while searching in the order in which they came
  JointFit fit;
  CrossValidation cv;
  std::vector<double> p_values, cv_gains;  // of `added`
};

}  // namespace robostress::calibration
