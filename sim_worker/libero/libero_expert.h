#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"

namespace robostress::libero {

class LiberoSimTask;

// A scripted policy for the task, closed loop on the true state, one command per prediction. Unimplemented
// for goals without a script; the message lists those that have one. `task` must outlive it.
absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeLiberoExpert(LiberoSimTask& task);

}  // namespace robostress::libero
