#include "common/rollout/replay_chunks.h"

#include <utility>

#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<std::vector<ExecutedChunk>> ReplayChunks(std::vector<ExecutedChunk> chunks,
                                                        int initial_state, Robot& robot) {
  RS_RETURN_IF_ERROR(robot.Reset(initial_state));
  RS_ASSIGN_OR_RETURN(RobotState state, robot.Measure());
  for (ExecutedChunk& chunk : chunks) {
    for (ExecutedStep& step : chunk.steps) {
      step.before = std::move(state);
      RS_RETURN_IF_ERROR(robot.Step(step.sent_command));
      RS_ASSIGN_OR_RETURN(state, robot.Measure());
    }
    chunk.final_state = state;
  }
  return chunks;
}

}  // namespace robostress
