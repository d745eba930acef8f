#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"
#include "server/edge/openpi_value.h"

namespace robostress {

// How openpi's observations become ours.
struct OpenpiInputOptions {
  // The client's key of each of the policy's cameras, in their order, "a/b" within nested maps.
  // Empty: the first of these that has them all: the cameras' own names, bare or under "images/" or
  // "observation/"; openpi's for LIBERO, DROID and ALOHA.
  std::vector<std::string> camera_keys;
  std::string default_prompt;  // where a client sends none; empty: it must
};

// The observation in a message: views as u1 [H, W, 3] or [3, H, W], or floats in 0..1 of the same
// shapes (converted as openpi does, by truncation); the state from "observation/state", "state", or
// joint and gripper position in a row; "prompt" as text or bytes. INVALID_ARGUMENT names the key.
absl::StatusOr<Observation> ReadOpenpiObservation(const OpenpiValue& message,
                                                  const PolicySpec& policy,
                                                  const OpenpiInputOptions& options);

}  // namespace robostress
