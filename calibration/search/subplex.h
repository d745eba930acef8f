#pragma once

#include <functional>
#include <vector>

#include "calibration/model/hypothesis.h"

namespace robostress::calibration {

struct SubplexMinimum {
  Eigen::VectorXd x;  // [free]
  double value = 0;
};

// The lowest of `error` that subplex (Rowan 1990; NLopt) finds from `start` within the bounds of
// `free`. It needs no gradient, which a run that sticks or slips does not have.
SubplexMinimum Subplex(const std::function<double(const Eigen::VectorXd&)>& error,
                       const std::vector<FreeParameter>& free, Eigen::VectorXd start,
                       int max_evaluations);

}  // namespace robostress::calibration
