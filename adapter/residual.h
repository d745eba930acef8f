#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"

// The compensation signal (paper, Eq. eta-obs and sec:supp_actspace):
//
//   eta_i = dx_i - a_i,   dx_i = ((p_{i+1} - p_i) / c_p,  Log(R_{i+1} R_i^-1) / c_r,  g_cmd)
//
// symbol  name               shape         unit
// eta     residual           [action_dim]  normalised action (joint space: rad)
// a       command            [action_dim]  normalised action (joint space: absolute target, rad)
// dx      achieved delta     [6]           normalised action
// c_p     translation_scale  -             m
// c_r     rotation_scale     -             rad
// g       tracking_gain      -             achieved / commanded displacement of a nominal arm
//
// The gripper is the last entry of an action; its residual is exactly 0. Rotations are world-frame
// differences along the short path.
namespace robostress {

struct MethodOptions;  // adapter/method_options.h

enum class ResidualScale { kCommand, kTracking };
enum class ResidualSpace {
  kEndEffector,  // 7-D delta poses; simulation
  kJoint,        // absolute joint targets, eta = q_{i+1} - q_ref (paper, sec:supp_real); Piper
};

struct ResidualOptions {
  ResidualSpace space = ResidualSpace::kEndEffector;
  double translation_scale = 0.05;                // c_p [m]
  double rotation_scale = 0.5;                    // c_r [rad]
  ResidualScale scale = ResidualScale::kCommand;  // tracking: dx is also divided by tracking_gain
  double tracking_gain = 0.267;
  // Against the command as the controller clips it to +-1; ignored in joint space.
  bool clip_command = true;
};

// The residual options that a method asks for.
ResidualOptions ResidualOptionsOf(const MethodOptions& method,
                                  ResidualSpace space = ResidualSpace::kEndEffector);

// The first `action_dim - 1` entries of `action` as the residual sees them: clipped or not.
Eigen::VectorXd ReferenceCommand(const Eigen::VectorXf& action, const ResidualOptions& options);

// dx of one control step [6], scaled as the options say; end-effector space.
Eigen::VectorXd AchievedDelta(const RobotState& before, const RobotState& after,
                              const ResidualOptions& options);

// eta of one control step against `command` [action_dim]; the gripper entry is 0.
Eigen::VectorXd StepResidual(const RobotState& before, const RobotState& after,
                             const Eigen::VectorXf& command, const ResidualOptions& options);

// The state after step i of an executed chunk.
const RobotState& StateAfter(const ExecutedChunk& chunk, size_t step);
// A chunk of that step alone.
ExecutedChunk StepOf(const ExecutedChunk& chunk, size_t step);

// Checks that an executed chunk is usable as feedback: at least one step, masks and the unadapted
// policy's commands for all steps or none, commands of `action_dim` entries, everything finite,
// unit quaternions, in joint space action_dim - 1 joints. The error names step, field and value.
absl::Status ValidateExecutedChunk(const ExecutedChunk& chunk, int action_dim, ResidualSpace space);

// eta against the policy's own (adapted) command, one row per executed step [steps, action_dim];
// Eq. eta-obs. Rows of masked steps are 0.
Eigen::MatrixXd ChunkResidual(const ExecutedChunk& chunk, const ResidualOptions& options);

}  // namespace robostress
