#pragma once

#include <Eigen/Core>
#include <functional>

namespace robostress {

// What a scripted expert would do now, and what it looks at.
struct ExpertDecision {
  Eigen::VectorXf command;                                // [7], normalised
  Eigen::Vector3d target = Eigen::Vector3d::Zero();       // what the tool goes for, base frame [m]
  Eigen::Vector3d destination = Eigen::Vector3d::Zero();  // where that shall end, base frame [m]
  bool holding = false;
  double progress = 0;  // of the task, 0 .. 1
};

// The scripted expert of a task: a function of the simulation's true state as it is now.
using Expert = std::function<ExpertDecision()>;

}  // namespace robostress
