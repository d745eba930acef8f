#pragma once

#include <optional>
#include <vector>

#include "adapter/adaptation_state.h"
#include "adapter/lora_adapter.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/prediction.h"

namespace robostress {

// Everything that a session's future depends on, at one moment. Tensors and observations are shared
// and immutable, so it is quick to make.
struct SessionSnapshot {
  v1::StateAdaptation counters;               // all but the adapter
  std::optional<AdaptationState> adaptation;  // without its buffer
  std::vector<BufferedChunk> buffer;
  std::vector<Prediction> outstanding;
  std::vector<PublishedVersion> versions;
};

}  // namespace robostress
