#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/robot.h"
#include "common/types.h"

namespace robostress {

// Plays the commands of an episode again, open loop: resets `robot` to `initial_state` and sends
// every step's sent_command, as many steps as were recorded, whatever becomes of the task. Returns
// the chunks with their commands and with the states of this play.
absl::StatusOr<std::vector<ExecutedChunk>> ReplayChunks(std::vector<ExecutedChunk> chunks,
                                                        int initial_state, Robot& robot);

}  // namespace robostress
