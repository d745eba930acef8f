#pragma once

#include <cstdint>
#include <memory>

#include "absl/time/time.h"
#include "server/inference/adaptation.h"
#include "server/inference/batcher.h"
#include "server/inference/prefix_store.h"
#include "server/policies/policy.h"

namespace robostress {

// What sessions share. Must outlive them.
struct SessionResources {
  std::shared_ptr<const FlowPolicy> policy;
  AdaptationLoop* adaptation = nullptr;
  Batcher* inference = nullptr;
  absl::Duration lockstep_timeout =
      absl::Seconds(120);  // for feedback that was announced and does not come
  std::shared_ptr<PrefixStore> prefixes = std::make_shared<PrefixStore>();
  // Of sessions with a journal: a snapshot is due after so much.
  uint64_t snapshot_bytes = uint64_t{64} << 20;
  uint64_t snapshot_records = 1024;
  // Predictions are on the disk before they are answered, so that a loss of power costs none. Off:
  // they survive the server's end, not the machine's.
  bool sync_predictions = false;
  AdaptationLoop* lockstep_adaptation = nullptr;  // of lockstep sessions; null: `adaptation`
  int max_view_side = 0;                          // [px] of any view; 0: the policy's own limit

  // Where sessions of a mode learn.
  AdaptationLoop* LearningOf(ExecutionMode mode) const {
    const bool apart = mode == ExecutionMode::kLockstep && lockstep_adaptation != nullptr;
    return apart ? lockstep_adaptation : adaptation;
  }
};

}  // namespace robostress
