#pragma once

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"
#include "proto/robostress/v1/policy.pb.h"

// What a session and a policy are. FromProto trusts nothing: sizes, ranges, finite numbers, names;
// an error is INVALID_ARGUMENT and names field, value and limit. What passes is exact: no number is
// rounded or normalised.
namespace robostress {

robostress::v1::SessionSpec ToProto(const RequestedSession& spec);
// Its method is text still.
absl::StatusOr<RequestedSession> FromProto(const robostress::v1::SessionSpec& message);

robostress::v1::PolicySpec ToProto(const PolicySpec& spec);
absl::StatusOr<PolicySpec> FromProto(const robostress::v1::PolicySpec& message);

robostress::v1::GetServerInfoResponse ToProto(const ServerInfo& info);
absl::StatusOr<ServerInfo> FromProto(const robostress::v1::GetServerInfoResponse& message);

}  // namespace robostress
