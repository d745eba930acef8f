#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/policies/nano/nano_weights.h"
#include "server/policies/policy.h"

namespace robostress {

// The embedded policy. Images of exactly the declared size are required: resizing differently from
// the training's renderer would be a silent shift of distribution. `model_hash` identifies the
// weights and `name` is what sessions ask for; both are reported in spec().
absl::StatusOr<std::unique_ptr<FlowPolicy>> MakeNanoPolicy(NanoModel model,
                                                           const std::string& model_hash,
                                                           const std::string& name = "nano");

// Times of the Euler steps, from t = 1 down by 1/steps, accumulated in float32 as the reference
// does.
std::vector<float> EulerTimes(int steps);

}  // namespace robostress
