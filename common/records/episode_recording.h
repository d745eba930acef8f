#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// The simulator before a control step, for LIBERO's form.
struct SimulatorRow {
  std::vector<double> state;      // time, qpos, qvel
  std::array<double, 7> joints;   // [rad]
  std::array<double, 2> fingers;  // [m]
  std::array<double, 3> ee_pos;   // grip site in the world [m]
  std::array<double, 3> ee_ori;   // axis-angle of the hand [rad]
  std::array<double, 4> ee_quat;  // of the hand, x y z w
};

// An episode as data sets want it: at every control step what was seen, what the policy asked for,
// what was sent, and what the arm did.
struct EpisodeRecording {
  struct Step {
    RobotState before;               // as the arm knows it
    Eigen::VectorXf proprioception;  // [8], as the policy is given it
    // [7] normalised action: of the policy; after corrections; and the displacement that the step
    // brought (adapter/residual.h), with the gripper command as sent.
    Eigen::VectorXf commanded, sent, measured;
    SimulatorRow simulator;
  };
  std::string suite, scenario, policy, method, task_name, instruction;
  std::string problem;  // LIBERO's class of the scene; empty: none of LIBERO's
  int severity = 5, task = 0, episode = 0, initial_state = 0;
  int64_t seed = 0;
  bool success = false;
  double rate_hz = 20;
  std::string model_file;  // the scene as MJCF, as it was in this episode
  std::vector<Step> steps;
  std::vector<std::string> cameras;
  std::vector<std::vector<std::string>> pictures;  // [camera][step] PNG, before the step
};

// safetensors, published whole. Rows are steps:
//   commanded, sent, measured F32 [T, 7]; proprioception F32 [T, 8]; q, dq [T, 7];
//   tool [T, 7] (p_base_tool [m], quaternion w x y z); gripper [T, 1]; simulator [T, n];
//   libero [T, 12] (fingers, ee_pos, ee_ori, ee_quat); picture.CAMERA U8, its PNGs one behind the
//   other, and picture.CAMERA.ends I64 [T]
// Everything else is metadata.
absl::Status WriteEpisodeRecording(const EpisodeRecording& recording, const std::string& file);
// Trusts nothing; errors name file and tensor or metadata key.
absl::StatusOr<EpisodeRecording> ReadEpisodeRecording(const std::string& file);
// The same of bytes; `name` for errors.
absl::StatusOr<EpisodeRecording> ParseEpisodeRecording(const std::string& name, std::string bytes);

}  // namespace robostress
