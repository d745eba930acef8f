#pragma once

#include <Eigen/Core>
#include <vector>

#include "sim_worker/suites/scene_spec.h"

namespace robostress {

// Indices from here on are training draws: an unlimited family that shares no draw with the
// reproducible initial states 0 .. SuiteInfo::num_initial_states - 1.

// Where an episode starts.
struct InitialState {
  Eigen::Matrix<double, 7, 1> q;           // arm [rad], before the settle steps
  std::vector<Eigen::Vector3d> positions;  // of the scene's props, in their order [m]
};

// A function of (suite, task, index) only. Props keep their distance from each other.
InitialState SampleInitialState(const SuiteSpec& suite, int task, int index);

// The arm's posture from which the initial states scatter: the tool points straight down over the
// table.
Eigen::Matrix<double, 7, 1> EmbeddedHome();

}  // namespace robostress
