#pragma once

#include <Eigen/Core>
#include <string>

#include "absl/status/status.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"

// What passes between a client and a policy, against the policy's declaration. Errors are
// INVALID_ARGUMENT and name what differs.
namespace robostress {

// Checks an observation against what the policy wants: the same cameras in the same order,
// state_dim. The message names what differs. Sizes of images are left to the policy, up to its
// max_view_side: one that resizes takes any, the others name their own.
absl::Status CheckObservation(const Observation& observation, const PolicySpec& spec);
// Checks what a prediction is to go on from: 1 to horizon rows x action_dim of commands, as many of
// them held as there are. UNIMPLEMENTED where the policy cannot.
absl::Status CheckRunningRows(const RunningRows& running, const PolicySpec& spec);
// Checks a prediction: horizon x action_dim, all finite.
absl::Status CheckPrediction(const PredictedChunk& prediction, const PolicySpec& spec);
// Checks that a prediction has rows enough to be executed: execute_steps x action_dim. INTERNAL.
absl::Status CheckExecutable(const PredictedChunk& prediction, const PolicySpec& spec);
// Checks an executed chunk: action_dim columns, steps within the predicted chunk.
absl::Status CheckExecutedChunk(const ExecutedChunk& chunk, const PolicySpec& spec);

// What motion is divided by: control period and scales of 1e-6..100. Below, what a robot can do
// would pass what a number can hold.
absl::Status CheckScales(const SessionSetting& spec);
// Checks a session's names ("spec.robot"), its severity of 1..5 and its scales. Its method is
// checked where it is read.
absl::Status CheckSessionSpec(const SessionSetting& spec);

// Checks a declared action range: none, or action_dim finite bounds with low <= high.
absl::Status CheckActionRange(const PolicySpec& spec);

// `field` names the matrix in the error.
absl::Status CheckMatrixSize(const std::string& field, const Eigen::MatrixXf& matrix, int rows,
                             int cols);

}  // namespace robostress
