#pragma once

#include "absl/status/status.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rpc/session_spec.h"

namespace robostress {

// Whether a session of this spec makes sense on this policy: method options within their ranges and
// consistent with each other and with the robot's action space. INVALID_ARGUMENT names option,
// value and remedy; NOT_FOUND for an unknown method lists the known ones.
absl::Status CheckSessionSpec(const SessionSpec& spec, const PolicySpec& policy);

}  // namespace robostress
