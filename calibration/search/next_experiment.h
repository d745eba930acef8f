#pragma once

#include <string>
#include <vector>

#include "calibration/search/joint_problem.h"

namespace robostress::calibration {

// A run that was not made, and how far apart models that fit the logs predict it.
struct NextExperiment {
  std::string what;  // "the motion of log_0.csv at twice the speed"
  std::string log;   // that it is made of
  // Times the log's speed, size and servo gain; 1 is as it is. More load on a transmission by this
  // share, and a known mass at the tip [kg].
  double speed = 1, size = 1, gain = 1, load = 0, mass = 0;
  // [rad, m; Nm or N where a motion is prescribed and torque is predicted] root mean square between
  // the first model and the one that is nearest to it: in that run, and in the log as it is.
  double apart = 0, now = 0;
  bool torque = false;
  double noise = 0;  // of a reading, in the same unit
  // What else could be read in the log as it is, and tells them better than that run does, beside
  // its own noise. Empty: nothing.
  struct Sensor {
    std::string what;  // "the motor's angle, before the transmission"
    double apart = 0;  // as above, without the zero of either [rad, m; Nm, N]
    bool torque = false;
  } sensor;
};

// Of the longest fitted log, as it is, faster, slower, smaller, with a known mass, and at other
// servo gains: the run that tells models[0] best from all others. A servo's motion is predicted
// from its command, by free runs of the problem's window from where models[0] is; of a torque that
// was logged the torque of the same motion; of a transmission the link. Another sensor of an angle
// is taken to be as good as the joint's, one of torque to be good to a hundredth.
// `what` is empty if nothing differs, if a sensor tells them and no run does, or if fewer than two
// models are given.
NextExperiment ProposeExperiment(const JointProblem& problem,
                                 const std::vector<JointModel>& models);

}  // namespace robostress::calibration
