#pragma once

#include "robot_client/control/control_loop.h"

namespace robostress {

// The chunk of 50 rows that answers `request`; target(i): the i-th, an ArmVector.
template <class Target>
ArmChunk AnswerTo(const PredictionRequest& request, const Target& target) {
  ArmChunk chunk;
  chunk.request = chunk.prediction_id = request.id;
  chunk.episode = request.episode;
  chunk.chunk = request.chunk;
  chunk.played = request.played;
  chunk.observed_ns = request.asked_ns;
  chunk.rows = 50;
  for (int i = 0; i < chunk.rows; ++i) chunk.policy[i] = chunk.requested[i] = target(i);
  return chunk;
}

}  // namespace robostress
