#pragma once

#include "common/rollout/policy_endpoint.h"
#include "common/types.h"

namespace robostress {

inline bool operator==(const EpisodeKey& a, const EpisodeKey& b) {
  return a.task == b.task && a.episode == b.episode;
}

// One prediction of an episode.
struct ChunkKey {
  EpisodeKey episode;
  int chunk = 0;  // within the episode
  friend bool operator==(const ChunkKey&, const ChunkKey&) = default;
};

inline ChunkKey KeyOf(const ExecutedChunk& executed) {
  return {{executed.task, executed.episode}, executed.chunk};
}

}  // namespace robostress
