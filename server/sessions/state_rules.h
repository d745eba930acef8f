#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "adapter/adaptation_state.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "server/policies/policy.h"
#include "server/sessions/prediction.h"

namespace robostress {

struct SessionSnapshot;

// What the state of a session of one spec on one policy is: the description that an import, a
// snapshot and the replay of a journal are held to before anything of them is taken. It is closed:
// a new session keeps it, and whatever is then done to a session that keeps it (feedback, episodes,
// updates, roll-backs, imports) keeps it again, so that a state which is refused is none that this
// server made. Shapes and types of tensors are held to VelocityField::context_shape() and the
// policy's sizes; those of LoRA and Adam where they are read (ParseAdaptationState) and, for their
// rank, by LoraAdapter::CheckShapes.
//
// Every function answers INVALID_ARGUMENT with field, value and limit. Not on the wire: a client's
// messages are checked by common/rpc.
class StateRules {
 public:
  // Of every number that something depends on; counts for people may be any. At one chunk a
  // millisecond it lasts 285,000 years; one more never overflows.
  static constexpr uint64_t kMaxCount = uint64_t{1} << 53;
  // Boundaries that wait for their feedback.
  static constexpr size_t kMaxBoundaries = 1024;

  // Both outlive it.
  StateRules(const SessionSpec* spec, const FlowPolicy* policy) : spec_(spec), policy_(policy) {}

  // `buffered`: chunks that come with it.
  absl::Status CheckAdaptation(const AdaptationState& state, size_t buffered) const;
  absl::Status CheckPrediction(const Prediction& prediction) const;
  // `context` where the chunk has no observation.
  absl::Status CheckBuffered(const torch::Tensor& target, const Observation* observation,
                             const PolicyContext& context) const;
  // Of a start of an episode. `low`: -1 where an import may have left it open.
  static absl::Status CheckEpisode(int64_t task, int64_t episode, int64_t low = 0);
  // Of what a prediction answers: what is above could not be read from the disk again.
  static absl::Status CheckKey(const ChunkKey& key);
  static absl::Status CheckCount(const char* field, uint64_t value);
  // All of the above but CheckBuffered, and what the parts have to do with each other. Versions are
  // checked by LoraAdapter::RestoreVersions, corrections by CommandCorrection::set_state.
  absl::Status CheckSnapshot(const SessionSnapshot& snapshot, size_t max_outstanding) const;

 private:
  absl::Status CheckChunk(const char* field, const torch::Tensor& tensor) const;
  // Whether the buffer holds a batch whenever an update falls due.
  absl::Status CheckSchedule(int64_t chunks_since_clear, size_t buffered) const;

  const SessionSpec* spec_;
  const FlowPolicy* policy_;
};

}  // namespace robostress
