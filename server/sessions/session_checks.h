#pragma once

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"

namespace robostress {

// Whether a session of this spec makes sense on this policy: method options within their ranges and
// consistent with each other and with the robot's action space. INVALID_ARGUMENT names option,
// value and remedy; NOT_FOUND for an unknown method lists the known ones.
absl::Status CheckSessionSpec(const SessionSpec& spec, const PolicySpec& policy);

// What the session's actions are: what the policy says, or the session where the policy does not.
// INVALID_ARGUMENT where they say different things, and where neither says anything and the method
// learns from motion or corrects commands.
absl::StatusOr<ControlSpace> ControlSpaceOf(const SessionSpec& spec, const PolicySpec& policy);

// What a session's adaptation may cost the server at most, whoever opens it. The paper's methods
// need rank 4, batch 4, an update every 8 chunks and a buffer of 32.
struct MethodCaps {
  int max_rank = 16;
  int max_batch = 8;
  int min_update_interval = 4;  // [chunks]
  int max_buffer_chunks = 128;
};

// The narrower of two in every limit.
MethodCaps Tightest(const MethodCaps& a, const MethodCaps& b);

// Asked when a session is opened; one that was opened under wider limits goes on. INVALID_ARGUMENT
// names option, value, limit and the flag that sets it. Methods that do not adapt pass.
absl::Status CheckMethodCaps(const MethodOptions& method, const MethodCaps& caps);

}  // namespace robostress
