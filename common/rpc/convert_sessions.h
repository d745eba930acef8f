#pragma once

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"
#include "proto/robostress/v1/policy.pb.h"

// How a session is served, what it counts and why it refuses; checked as in convert_specs.h.
namespace robostress {

robostress::v1::Priority ToProto(Priority priority);
absl::StatusOr<Priority> FromProto(robostress::v1::Priority message);

// The status that a refusal stands for, with its mark (common/rollout/refusal.h), and back.
absl::Status ToStatus(const robostress::v1::Refusal& refusal);
robostress::v1::Refusal ToRefusal(const absl::Status& status);

robostress::v1::GetStatsResponse ToProto(const SessionStats& stats);
absl::StatusOr<SessionStats> FromProto(const robostress::v1::GetStatsResponse& message);

}  // namespace robostress
