#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"
#include "common/wire/openpi_value.h"

namespace robostress {

// [px] Greatest side of a view that is resized here, where nobody says otherwise: for all clients,
// as the operator wants it (a camera's 1280 x 720), or for a client that asks for it (openpi's send
// 224, LIBERO renders 256).
inline constexpr int kResizedViewSide = 1280, kResizedOnRequestSide = 256;

// How openpi's observations become ours.
struct OpenpiInputOptions {
  // The client's key of each of the policy's cameras, in their order, "a/b" within nested maps.
  // Empty: the first of these that has them all: the cameras' own names, bare or under "images/" or
  // "observation/"; those of OpenpiDialects (openpi_dialect.h).
  std::vector<std::string> camera_keys;
  std::string default_prompt;  // where a client sends none; empty: it must
  // Views of other sizes than the policy's are resized as openpi's resize_with_pad does, where the
  // policy does not do so itself. What is resized is what the session sees, keeps and learns from.
  bool resize = false;
  int max_view_side = 0;  // [px]; 0: what the policy takes, or where views are resized the above
};

// [px] The greatest side of a view that a client may send. `asked`: this client asks for resizing.
int LargestViewSide(const PolicySpec& policy, const OpenpiInputOptions& options, bool asked);

// The observation in a message: views as u1 [H, W, 3] or [3, H, W], or floats in 0..1 of the same
// shapes (converted as openpi does, by truncation); the state from "observation/state", "state", or
// joint and gripper position in a row, each at the message's top or within maps; "prompt" as text
// or bytes. `asked`: as above. INVALID_ARGUMENT names the client's key and what to do.
absl::StatusOr<Observation> ReadOpenpiObservation(const OpenpiValue& message,
                                                  const PolicySpec& policy,
                                                  const OpenpiInputOptions& options, bool asked);

}  // namespace robostress
