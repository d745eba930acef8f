#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"

namespace robostress {

// A policy that plays a recorded command sequence: tensor `actions` [T, 7], F32 or F64, of a
// safetensors file. It sees nothing; after the last command it holds still with the last gripper
// command.
absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeReplayPolicy(const std::string& file);

}  // namespace robostress
