#pragma once

#include <Eigen/Core>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rpc/session_spec.h"
#include "common/types.h"
#include "proto/robostress/v1/policy.pb.h"

// The only place where protobuf meets the domain types. FromProto trusts nothing: sizes, ranges,
// finite numbers, unit quaternions; an error is INVALID_ARGUMENT and names field, value and limit.
// What passes is exact: no number is rounded or normalised.
namespace robostress {

// What a message may hold at most; far above what a policy uses, far below what hurts a server.
struct WireLimits {
  static constexpr int kName = 256;          // bytes of a name
  static constexpr int kInstruction = 4096;  // bytes
  static constexpr int kMethodYaml = 65536;  // bytes
  static constexpr int kViews = 16;
  static constexpr int kImageSide = 4096;  // [px]
  static constexpr int kStateDim = 1024;
  static constexpr int kActionDim = 256;
  static constexpr int kHorizon = 1024;  // rows of a chunk
  static constexpr int kDof = 64;
  static constexpr int kIndex = 1 << 24;  // task, episode, chunk
  static constexpr double kQuaternionNormError = 1e-3;
};

robostress::v1::SessionSpec ToProto(const SessionSpec& spec);
absl::StatusOr<SessionSpec> FromProto(const robostress::v1::SessionSpec& message);
// What a server wrote, whose dump of a method names every option that its version had: those that
// came later are at their defaults, which change nothing, and not at the preset's.
absl::StatusOr<SessionSpec> FromStored(const robostress::v1::SessionSpec& message);

robostress::v1::PolicySpec ToProto(const PolicySpec& spec);
absl::StatusOr<PolicySpec> FromProto(const robostress::v1::PolicySpec& message);

robostress::v1::Priority ToProto(Priority priority);
absl::StatusOr<Priority> FromProto(robostress::v1::Priority message);

robostress::v1::GetServerInfoResponse ToProto(const ServerInfo& info);
absl::StatusOr<ServerInfo> FromProto(const robostress::v1::GetServerInfoResponse& message);

robostress::v1::Observation ToProto(const Observation& observation);
absl::StatusOr<Observation> FromProto(const robostress::v1::Observation& message);

robostress::v1::FloatMatrix ToProto(const Eigen::MatrixXf& matrix);
// `field` names the matrix in errors.
absl::StatusOr<Eigen::MatrixXf> FromProto(const char* field,
                                          const robostress::v1::FloatMatrix& message);

// `chunk`: of the request that is answered.
robostress::v1::PredictResponse ToProto(const PredictedChunk& prediction, int chunk);
absl::StatusOr<PredictedChunk> FromProto(const robostress::v1::PredictResponse& message);

// The status that a refusal stands for, with its mark (common/rpc/refusal.h), and back.
absl::Status ToStatus(const robostress::v1::Refusal& refusal);
robostress::v1::Refusal ToRefusal(const absl::Status& status);

robostress::v1::RobotState ToProto(const RobotState& state);
absl::StatusOr<RobotState> FromProto(const robostress::v1::RobotState& message);

// All steps have base commands or none has; RS_CHECKed.
robostress::v1::ExecutedChunk ToProto(const ExecutedChunk& chunk);
absl::StatusOr<ExecutedChunk> FromProto(const robostress::v1::ExecutedChunk& message);

robostress::v1::GetStatsResponse ToProto(const SessionStats& stats);
absl::StatusOr<SessionStats> FromProto(const robostress::v1::GetStatsResponse& message);

}  // namespace robostress
