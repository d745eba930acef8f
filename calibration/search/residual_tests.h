#pragma once

#include <string>
#include <vector>

#include "calibration/search/calibration_report.h"
#include "calibration/search/joint_problem.h"

namespace robostress::calibration {

// Autocorrelation of projected residuals within windows, lags up to 20 rows.
WhitenessReport TestWhiteness(const JointProblem& problem, const Eigen::VectorXd& residual,
                              const WindowSet& chosen);

// Means of the projected residuals of two models over bins of position, velocity, load, time and
// the motion of every other joint, and their spectra. `scale` turns them into the unit of the
// report.
std::vector<StructureCurve> MeasureStructure(const JointProblem& problem,
                                             const JointModel& declared, const JointModel& after,
                                             const WindowSet& chosen, double scale);

// Where a residual stands out of a curve: ", most of it at 0.3 to 0.4 rad". Empty: it is spread.
std::string WhereItIs(const StructureCurve& curve, bool after);

}  // namespace robostress::calibration
