#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "adapter/adaptation_state.h"
#include "adapter/command_correction.h"
#include "server/sessions/learner.h"
#include "server/sessions/prediction.h"

namespace robostress {

// Everything that a session's future depends on, at one moment. Tensors and observations are shared
// and immutable, so it is quick to make. One that was read is what a file says: StateRules before
// anything of it is taken.
struct SessionSnapshot {
  uint64_t feedback_sequence = 0, feedback_chunks = 0;
  uint64_t next_prediction = 0, predictions = 0, predictions_dropped = 0;
  uint64_t duplicates = 0, steps_masked = 0, steps_impossible = 0;
  Learner::Counters learning;
  bool episode_started = false;
  int64_t task = -1, episode = -1;
  std::optional<uint32_t> next_chunk;  // nullopt: of an older server; the predictions say
  std::vector<uint64_t> boundaries;
  CommandCorrection::State correction;
  std::optional<AdaptationState> adaptation;  // without its buffer
  std::vector<BufferedChunk> buffer;
  std::vector<Prediction> outstanding;
  std::vector<PublishedVersion> versions;
};

}  // namespace robostress
