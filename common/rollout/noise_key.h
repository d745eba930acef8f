#pragma once

#include <cstdint>
#include <string>

#include "common/random.h"
#include "common/rollout/chunk_key.h"
#include "common/rollout/session_spec.h"

namespace robostress {

// Key of the sampling noise of one prediction, whoever draws it: (noise stream, seed, suite, task,
// episode, chunk) and nothing else, so it is equal for every method and scenario. `noise_stream`:
// MethodOptions'.
inline StreamKey PredictionNoiseKey(const SessionSetting& setting, const std::string& noise_stream,
                                    const ChunkKey& key) {
  return StreamKey("prediction_noise")
      .With(noise_stream)
      .With(setting.seed)
      .With(setting.suite)
      .With(int64_t{key.episode.task})
      .With(int64_t{key.episode.episode})
      .With(int64_t{key.chunk});
}

}  // namespace robostress
