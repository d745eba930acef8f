#pragma once

#include <Eigen/Core>

#include "sim_worker/panda_sim.h"
#include "sim_worker/suites/task_model.h"

namespace robostress {

// What the expert would do now, and what it looks at.
struct ExpertDecision {
  Eigen::VectorXf command;                                // [7], normalised
  Eigen::Vector3d target = Eigen::Vector3d::Zero();       // what the tool goes for, base frame [m]
  Eigen::Vector3d destination = Eigen::Vector3d::Zero();  // where that shall end, base frame [m]
  bool holding = false;
  double progress = 0;  // of the task, 0 .. 1
};

// The scripted expert: a closed loop without memory. The phase (reach, close, carry, let go, turn
// ...) follows from the state alone, so that its commands are a function of what can be observed
// and a policy without memory can imitate them. Commands are proportional with a cap (headroom for
// correction) and a floor (stiction swallows small commands; see kMinCommand).
ExpertDecision DecideExpert(const TaskModel& model, const PandaSim& sim);

}  // namespace robostress
