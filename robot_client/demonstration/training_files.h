#pragma once

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "robot_client/demonstration/demonstration.h"

namespace robostress {

using ToolPoseOf = std::function<Pose(const ArmVector& position)>;

// One episode as a file in LIBERO's form (common/libero/demonstrations.h), for two cameras: the
// first is agentview, the second eye_in_hand. What differs on this arm: actions are absolute joint
// targets [rad] and the opening [m], joint_states the joints and the opening, obs/proprioception
// those with a zero behind them. The tool's pose is `tool`'s.
absl::Status WriteLiberoEpisode(const DemonstrationEpisode& episode, const ToolPoseOf& tool,
                                const std::string& path);

// One episode as a shard that `robostress train` reads for a policy in joint space, as piper-study
// records them: every `stride`-th tick a frame with `horizon` rows of targets, the last one
// repeated after the end, and views of `side` pixels. No auxiliary targets: train with aux_weight
// 0.
absl::Status WriteShard(const DemonstrationEpisode& episode, int64_t index, int side, int stride,
                        int horizon, const std::string& path);

}  // namespace robostress
