#pragma once

#include <string>

#include "absl/status/status.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// Whether a folder is a data set of LeRobot: it has meta/info.json.
bool IsLerobotFolder(const std::string& folder);

// A data set of LeRobot v2.x or v3.0, a group of rows in memory at a time; pictures are not
// touched. meta/info.json decides what is read:
//
//   observation.joints or observation.state   positions, by their `names`
//   observation.joint_velocities, .velocity   velocities
//   observation.effort, .torque               efforts
//   action                                    commands, where its names are those of the positions
//   timestamp, episode_index                  times, and where they begin anew
//
// info.json says no unit. INVALID_ARGUMENT names file, field, value and remedy.
absl::Status ReadLerobotRecording(const std::string& folder, RowStream* rows);

}  // namespace robostress
