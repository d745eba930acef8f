#pragma once

#include "absl/status/statusor.h"
#include "common/libero/demonstrations.h"
#include "sim_worker/record/expert_demonstration.h"

namespace robostress {

// A recorded episode in LIBERO's form; its frames must be one control step apart and carry what
// ReadSimulator gave. Actions are the labels' first rows: the expert's commands without noise.
// libero_suite: views are turned back as LIBERO stores them, and what the policy is given is left
// out, because it is ee_pos, ee_ori and gripper_states.
LiberoDemonstration ToLibero(const Demonstration& demonstration, const std::string& model_file,
                             bool libero_suite);

}  // namespace robostress
