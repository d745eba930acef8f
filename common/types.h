#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <vector>

namespace robostress {

// An 8-bit RGB image, row-major from the top-left corner: pixel (row, col) starts at
// data[3 * (row * width + col)].
struct Image {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> data;
};

// One camera's view; names are those the policy declares (PolicySpec::cameras).
struct CameraView {
  std::string camera;
  Image image;
};

// What a policy may see: no simulator state, no task index.
struct Observation {
  std::string instruction;
  std::vector<CameraView> views;
  Eigen::VectorXf
      proprioception;  // [state_dim]; simulation: p [m], axis-angle [rad], finger qpos [m]
};

// End-effector pose in the robot's base frame.
struct Pose {
  Eigen::Vector3d p_base_tool = Eigen::Vector3d::Zero();  // [m]
  Eigen::Quaterniond q_base_tool = Eigen::Quaterniond::Identity();
};

// The measured state of a robot at one control step.
struct RobotState {
  double stamp_s = 0;  // since the start of the episode [s]
  Eigen::VectorXd q;   // joint positions [dof] [rad]
  Eigen::VectorXd dq;  // joint velocities [dof] [rad/s]
  Pose tool;           // end-effector pose
  double gripper = 0;  // opening [m]
};

// One executed control step of a chunk: state before, commands, state after.
struct ExecutedStep {
  RobotState before;
  Eigen::VectorXf policy_command;  // [action_dim], the policy's (adapted) action, environment units
  Eigen::VectorXf
      base_command;  // [action_dim] or empty: the unadapted policy's, if it was computed
  Eigen::VectorXf sent_command;  // [action_dim], what the controller received
};

// The executed part of one action chunk: feedback to the server. states = steps + final_state.
struct ExecutedChunk {
  uint64_t sequence = 0;            // 1, 2, 3 ... within a session, no gaps
  int task = 0;                     // index in the suite
  int episode = 0;                  // index within the task
  int chunk = 0;                    // index within the episode
  uint64_t prediction_id = 0;       // PredictedChunk::prediction_id that was executed
  int first_step = 0;               // index of steps[0] within the predicted chunk
  std::vector<ExecutedStep> steps;  // size >= 1
  RobotState final_state;           // after the last step
  bool last_of_episode = false;
  // [steps] or empty (none): steps whose motion says nothing about the robot, because limiter or
  // cross-fade moved the command or the state after it was not measured. Their residual counts as
  // zero.
  std::vector<bool> masked;

  bool IsMasked(size_t step) const { return step < masked.size() && masked[step]; }
};

// A predicted action chunk in environment units: rows are control steps.
struct PredictedChunk {
  uint64_t prediction_id = 0;
  Eigen::MatrixXf actions;         // [horizon, action_dim] to send to the robot
  Eigen::MatrixXf policy_actions;  // [horizon, action_dim] before a correction (direct, gain);
                                   // equal to actions otherwise
  Eigen::MatrixXf base_actions;    // [horizon, action_dim] of the unadapted policy, or 0 x 0
  uint64_t adapter_version = 0;    // number of updates applied when it was predicted
  // How a server served it: waited for a place in a batch, computed [ms], predictions of the batch.
  // 0: not measured.
  double queue_ms = 0, compute_ms = 0;
  int batch_size = 0;
};

}  // namespace robostress
