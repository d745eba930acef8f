#pragma once

#include <cstddef>

#include "common/rollout/policy_endpoint.h"

// How large a message may be that carries what a policy takes: what is longer is nonsense, and is
// refused before it is held. A function of what the policy declares, the same for every wire.
namespace robostress {

// Bytes of the greatest observation: every camera's view with sides of `max_view_side` [px], the
// state, the longest prompt, and the names beside them. `value_bytes`: of a colour value as the
// wire takes it; openpi's takes float64, gRPC bytes.
size_t LargestObservationBytes(const PolicySpec& policy, int max_view_side,
                               size_t value_bytes = sizeof(double));

// Bytes of the greatest report: every step of a whole horizon, with the states of the most joints
// that a robot may have and three rows of commands, in float64.
size_t LargestExecutedBytes(const PolicySpec& policy);

}  // namespace robostress
