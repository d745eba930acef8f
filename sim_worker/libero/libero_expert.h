#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"

namespace robostress::libero {

class LiberoSimTask;

// A scripted policy for the task, closed loop on the true state, one command per prediction: a
// phase per skill (reach, grasp, lift, carry, lower, let go; or reach, grasp, pull), which starts
// over when the grasp is lost. Unimplemented for goals without a script; the message says which
// have one. `task` must outlive it.
absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeLiberoExpert(const LiberoSimTask& task);

}  // namespace robostress::libero
