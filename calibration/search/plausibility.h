#pragma once

#include <string>
#include <vector>

#include "calibration/search/joint_fit.h"

namespace robostress::calibration {

// Whether a free parameter may stand on its bound and still be meant: a size of 0, where the effect
// has others, is that part's absence.
bool IsAbsence(const Hypothesis& h, int free);

// Why the numbers of an effect of a fit can not be believed: a parameter on a bound, or one that
// has no standard error. std [free]: StandardDeviations of the fit. Empty: they can.
std::string ParameterDoubt(const JointFit& fit, const std::vector<double>& std,
                           const std::string& effect);

// Why no machine can be as the model: friction that would drive the joint one way at a place, speed
// and time that the logs hold, or a drive that would fade to nothing. Friction may be negative
// within two standard errors of its parts.
std::string PhysicalDoubt(const JointProblem& problem, const JointFit& fit,
                          const std::vector<double>& std);

}  // namespace robostress::calibration
