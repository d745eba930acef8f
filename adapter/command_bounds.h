#pragma once

#include <Eigen/Core>

#include "common/rollout/message_limits.h"
#include "common/rollout/policy_endpoint.h"

namespace robostress {

// |entry| of any command, environment units: nothing that this project drives takes commands near
// it. Where a policy declares no range it is the only bound.
inline constexpr float kWidestCommand = WireLimits::kWidestAction;

// Holds `commands` [horizon, action_dim], what the corrections made of the policy's `own`, to the
// policy's declared range, widened by its own span to either side and by `own`:
//
//   low  = min(action_low - (action_high - action_low), own)       high likewise
//
// An adapter's policy may pass its range by a little, and a correction is there to command more
// than a healthy arm would need: by 1 where a limit of the methods lets it, by 2.3 where `direct`
// doubles a command. Within that a command keeps its bits, so clean runs and every committed table
// keep theirs; beyond it lies only what a wrong measurement made. A value that is not a number
// becomes the policy's own.
void BoundCommands(const PolicySpec& spec, const Eigen::MatrixXf& own, Eigen::MatrixXf& commands);

}  // namespace robostress
