#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"
#include "proto/robostress/v1/policy.pb.h"

// What was predicted and what was executed; checked and exact as in convert_specs.h, quaternions of
// norm 1 too.
namespace robostress {

robostress::v1::FloatMatrix ToProto(const Eigen::MatrixXf& matrix);
// `field` names the matrix in errors.
absl::StatusOr<Eigen::MatrixXf> FromProto(const char* field,
                                          const robostress::v1::FloatMatrix& message);

// `chunk`: of the request that is answered.
robostress::v1::PredictResponse ToProto(const PredictedChunk& prediction, int chunk);
absl::StatusOr<PredictedChunk> FromProto(const robostress::v1::PredictResponse& message);

robostress::v1::RunningRows ToProto(const RunningRows& running);
absl::StatusOr<RunningRows> FromProto(const robostress::v1::RunningRows& message);

robostress::v1::RobotState ToProto(const RobotState& state);
absl::StatusOr<RobotState> FromProto(const robostress::v1::RobotState& message);

// All steps have base commands or none has; RS_CHECKed.
robostress::v1::ExecutedChunk ToProto(const ExecutedChunk& chunk);
absl::StatusOr<ExecutedChunk> FromProto(const robostress::v1::ExecutedChunk& message);

}  // namespace robostress
