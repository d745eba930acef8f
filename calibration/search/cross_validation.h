#pragma once

#include <vector>

#include "calibration/search/joint_fit.h"

namespace robostress::calibration {

// The windows that each fold leaves out: one condition, one log, or every fifth block of the fit
// logs. Automatic: conditions where there are two, else logs where there are three, else blocks.
std::vector<WindowSet> MakeFolds(const JointProblem& problem, Folds folds);

// Windows that have rows, but for the tenth of them with the largest mean energy.
WindowSet WithoutLargest(const std::vector<double>& energy, const std::vector<int>& rows);

// Errors of windows that a fit of the other folds predicts.
struct CrossValidation {
  std::vector<double> energy;      // [windows] sum of squares of projected residuals; fit windows
  std::vector<int> rows;           // [windows]
  std::vector<double> fold_rms;    // [folds]
  std::vector<Eigen::VectorXd> x;  // [folds] parameters
  double Rms() const;
  // Of the windows chosen.
  double Rms(const WindowSet& chosen) const;
  // WithoutLargest: where a joint nearly sticks, a model that is right may slip too late, and a few
  // windows are far off.
  WindowSet Bulk() const;
};

// Refits from fit.best on every fold.
CrossValidation CrossValidate(const JointProblem& problem, const JointFit& fit,
                              const std::vector<WindowSet>& folds);

// Mean squared error of b less that of a, and its standard error over windows.
struct PairedDifference {
  double mean = 0, standard_error = 0;
};
PairedDifference Compare(const CrossValidation& a, const CrossValidation& b);

}  // namespace robostress::calibration
