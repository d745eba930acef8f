#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/rollout/robot.h"

namespace robostress {

enum class ObservationInput;  // adapter/method_options.h

// A robot whose policy is denied one of its inputs, to measure how much the policy depends on it:
//   shuffled_instruction  another task's instruction, the others of the suite in turn by episode
//   blank_images          every view mid-grey (128), which a policy's normalisation takes to about
//   0 frozen_state          the proprioception of the episode's first observation
// Robot and measurement are the true ones; only Observe differs. `instructions` are the suite's, in
// task order, and needed for shuffled_instruction alone.
std::shared_ptr<Robot> ControlObservations(std::shared_ptr<Robot> robot, ObservationInput input,
                                           std::vector<std::string> instructions, int task);

}  // namespace robostress
