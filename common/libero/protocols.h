#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// How somebody else evaluates policies on LIBERO's suites: what `robostress sweep --protocol NAME`
// sets. Episode k of a task starts from its initial state k.
struct LiberoProtocol {
  std::string name;
  std::vector<std::pair<std::string, int>> step_limits;  // suite, control steps after settling
  int settle_steps = 10;  // control steps with zero motion and an open gripper, before that
  int execute_steps = 5;  // of a chunk before the next prediction
  int image_size = 224;   // [px] of the square views that a policy is sent
  int episodes = 50;      // a task
  int64_t seed = 7;       // of the run
  std::string fixtures;   // where that seed puts fixtures: ParseLiberoFixtures reads it
  // Of a suite, or of the one whose name and '_' its name begins with (libero_goal_swap); 0 for one
  // without a limit.
  int StepLimit(const std::string& suite) const;
};

// openpi's examples/libero/main.py (15a9616), and LeRobot's documented evaluation: envs/libero.py,
// configs/eval.py, docs/source/libero.mdx (7427f31).
const std::vector<LiberoProtocol>& LiberoProtocols();
// "openpi, lerobot"
std::string LiberoProtocolNames();
// NotFound names those that exist.
absl::StatusOr<LiberoProtocol> FindLiberoProtocol(const std::string& name);

}  // namespace robostress
