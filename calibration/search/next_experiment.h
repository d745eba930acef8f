#pragma once

#include <string>
#include <vector>

#include "calibration/search/joint_problem.h"

namespace robostress::calibration {

// A run that was not made, and how far apart models that fit the logs predict it.
struct NextExperiment {
  std::string what;  // "the motion of log_0.csv at twice the speed"
  // [rad, m; Nm or N where a motion is prescribed and torque is predicted] root mean square between
  // the first model and the one that is nearest to it: in that run, and in the log as it is.
  double apart = 0, now = 0;
  bool torque = false;
};

// Of the longest fitted log, as it is, faster, slower, smaller, with a known mass, and at other
// servo gains: the run that tells models[0] best from all others. A servo's motion is predicted
// from its command, by free runs of the problem's window from where models[0] is; of a torque that
// was logged the torque of the same motion; of a transmission the link. `what` is empty if nothing
// differs, or fewer than two models are given.
NextExperiment ProposeExperiment(const JointProblem& problem,
                                 const std::vector<JointModel>& models);

}  // namespace robostress::calibration
