#pragma once

#include <cstdint>
#include <string>
#include <variant>

#include "common/rollout/chunk_key.h"
#include "common/types.h"
#include "server/sessions/prediction.h"

namespace robostress {

struct EpisodeStarted {
  EpisodeKey key;
  uint64_t last_sequence = 0;  // feedback that belongs to what came before it
};
struct AdapterImported {
  std::string safetensors;
};
struct AdapterRolledBack {
  uint64_t version = 0;
};
struct VersionPinned {
  uint64_t version = 0;
  bool pinned = false;
};

// What a journal holds: everything that changes a session's feedback sequence, and the predictions
// that it reports on. Replayed in order it makes the session again, in every bit.
using SessionEvent = std::variant<Prediction, ExecutedChunk, EpisodeStarted, AdapterImported,
                                  AdapterRolledBack, VersionPinned>;

}  // namespace robostress
