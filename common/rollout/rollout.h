#pragma once

#include <functional>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/late_play.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/robot.h"

namespace robostress {

// What happened in one episode.
struct EpisodeRecord {
  bool success = false;
  int steps = 0;
  std::vector<ExecutedChunk> chunks;
  double predict_s = 0, step_s = 0, observe_s = 0,
         feedback_s = 0;  // wall time, kept out of the tables
};

struct RolloutOptions {
  int initial_state = 0;
  std::function<void(int step)> on_step;  // e.g. to film; called after Reset (0) and each step
  LatePlay late;                          // answers that take time
  int execute_steps = 0;                  // in place of the policy's own; 0: those. Not with late
};

// One episode: observe, predict, execute the first execute_steps rows, send feedback; ends at
// success or horizon. Feedback sequence numbers continue from `sequence`. Where answers take time
// the loop is that of late_rollout.h.
absl::StatusOr<EpisodeRecord> RunEpisode(const EpisodeKey& key, const RolloutOptions& options,
                                         Robot& robot, PolicyEndpoint& policy, uint64_t& sequence);

}  // namespace robostress
