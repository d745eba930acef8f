#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include "common/rollout/robot.h"

namespace robostress {

// What another program sees of a task, beside its state.
struct EnvironmentViews {
  std::vector<std::string> cameras;  // in the order of their images
  int size = 224;                    // [px] of a side
};

// Lets another program play a robot's task by lines of JSON, one answer to each, until `in` ends:
//   {"reset": 12}                     initial state 12, settled
//   {"step": [0.1, 0, 0, 0, 0, 0, 1]} one control step with a command of `action_dim` numbers;
//                                     those outside [-1, 1] are the controller's to clip
// An answer is
//   {"step": 3, "success": false, "agent_pos": [8], "instruction": "...", "image_bytes": 301056,
//    "state": {"stamp_s", "q": [rad], "dq": [rad/s], "position": [m], "quaternion": [w, x, y, z],
//              "gripper": [m]}}
// and image_bytes behind its line: the cameras' views, size x size x RGB, top row first. Numbers
// are read back to the last bit. A request that is wrong is answered with {"error": "..."}
// and changes nothing; a step before the first reset is one. Returns what ended it early: an answer
// that could not be written, a line longer than 64 KiB.
absl::Status ServeEnvironment(Robot& robot, const EnvironmentViews& views, int action_dim,
                              std::istream& in, std::ostream& out);

}  // namespace robostress
