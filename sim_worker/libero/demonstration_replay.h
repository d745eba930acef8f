#pragma once

#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/safetensors.h"
#include "sim_worker/libero/libero_sim_task.h"

namespace robostress::libero {

// A recorded run of a task: where it starts, and its commands.
struct Recording {
  std::vector<double> init_state;     // [1 + nq + nv]: time, qpos, qvel
  std::vector<double> reset_qpos;     // [nq] where the originals' controller was reset
  Eigen::Matrix<double, 7, 1> home;   // the arm's joints in it [rad]
  std::vector<FixturePose> fixtures;  // empty: where the task has them
  std::vector<double> actions;        // [T, 7] normalised commands
  int steps() const { return static_cast<int>(actions.size() / 7); }
};

// Reads `actions` [T, 7], `init_state` [1 + nq + nv], `reset_qpos` [nq], of which the arm counts,
// and, if the file has them, `body_pos` [nbody, 3] and `body_quat` [nbody, 4], of which the
// fixtures count.
absl::StatusOr<Recording> ReadRecording(const SafetensorsFile& file, const LiberoSimTask& task);

// Plays a recording; the first `settle_steps` commands at progress 0. Adds what happened to `out`,
// row 0 before the first command, row t after command t:
//   time [T+1], qpos [T+1, nq], qvel [T+1, nv], ctrl [T+1, nu], torque [T+1, 7] [Nm], ncon,
//   success, reward eef_pos [T+1, 3], eef_quat [T+1, 4] (x y z w), gripper_qpos [T+1, 2]: as
//   observed goal_pos [T+1, 3], goal_ori [T+1, 9]: the controller's; goal_pos0 [3], goal_ori0 [3,
//   3] sub_torque_first10 [min(T, 10), 25, nu]: ctrl of every sub-step
// and its inputs, and the compiled model's arrays as model.* (model_arrays.h).
absl::Status Replay(const Recording& recording, int settle_steps, LiberoSimTask& task,
                    SafetensorsWriter& out);

}  // namespace robostress::libero
