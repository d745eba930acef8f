#pragma once

#include <string>

#include "absl/status/status.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// Whether a file's name is that of an HDF5 file.
bool IsHdf5Name(const std::string& name);

// Demonstrations in HDF5, an episode in memory at a time. Such files hold no times: rows are put at
// a rate, `rate_hz` or, where that is 0, the one that the file or its kind says.
//
//   ALOHA             observations/qpos, qvel, effort and action [rows, joints], 50 Hz by its code;
//                     an action is the position that the follower was asked for
//   robomimic, LIBERO data/DEMO/obs/{robot0_joint_pos, joint_states}, robot0_joint_vel,
//                     control_freq of data@env_args; actions are motions of the tool, no commands
//
// INVALID_ARGUMENT names file, dataset, shape and remedy.
absl::Status ReadHdf5Recording(const std::string& path, double rate_hz, RowStream* rows);

}  // namespace robostress
