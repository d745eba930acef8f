#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/motion/motion.h"

namespace robostress {

// A motion from
//
//   FILE.csv         columns t [s] and q_cmd_J1 .. [rad], or q_cmd_NAME by the joints' names in
//                    `rig_names`, and q_cmd_gripper [m], of which those that are missing stay
//                    where they are; times are counted from the first row
//   a run's folder   what robot_client sent in an episode of it (ticks.csv, columns sent_*); a run
//                    without episodes: its longest way of the client's own
//   a data set       the actions of an episode that robot_client recorded (lerobot/, or the folder
//                    above it)
//
// `axes`: of the arm that is to play it; a run or a data set must be of as many. `rig_names`: what
// rigs call its joints, from the base on; empty: J1 and on, too. `episode`: which one; nothing: the
// only one there is. NOT_FOUND, INVALID_ARGUMENT: file, line or
// column, value, remedy. Whether an arm can follow it is CheckMotion's to say.
absl::StatusOr<Motion> ReadMotion(const std::string& path, std::optional<int> episode,
                                  const ArmAxes& axes = {},
                                  const std::vector<std::string>& rig_names = {});

}  // namespace robostress
