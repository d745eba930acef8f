#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/random.h"
#include "common/rollout/chunk_key.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "server/inference/batcher.h"
#include "server/inference/prefix_store.h"
#include "server/policies/policy.h"

namespace robostress {

// What is remembered of a prediction until its feedback arrives. Immutable tensors and snapshots,
// so a copy is cheap.
struct Prediction {
  uint64_t id = 0;
  ChunkKey key;
  // Undefined and null where the method does not adapt.
  torch::Tensor raw;    // [K, d] model space
  torch::Tensor state;  // PolicyContext::state
  std::shared_ptr<const Observation> observation;
  std::shared_ptr<const PrefixStore::Prefix> prefix;  // of `observation`
  Eigen::MatrixXf base;  // [K, action_dim] of the unadapted policy; where the target needs it
  // What its client was answered, for a report that says no more than what was measured. Null: of a
  // journal older than this field.
  std::shared_ptr<const PredictedChunk> answered;
  bool journaled = false;  // its record is in the journal
};

// A training chunk while nothing computes with it.
struct BufferedChunk {
  std::shared_ptr<const Observation> observation;  // null: imported, the prefix is all there is
  std::shared_ptr<const PrefixStore::Prefix> prefix;
  torch::Tensor target;  // [K, d] model space
};

// The identity that keys phi_0 and every draw of an update. The sampling noise has a key of its
// own.
std::string SessionIdentity(const SessionSpec& spec);
// PredictionNoiseKey of a session (common/rollout/noise_key.h).
StreamKey NoiseKey(const SessionSpec& spec, const ChunkKey& key);

// Standard normal noise [1, K, d] of `key`.
torch::Tensor DrawNoise(const StreamKey& key, int64_t horizon, int64_t dim);

// Encodes and samples in a batch with others, from the noise of `key`: with the job's adapter, and
// without it where the method wants the unadapted actions: those of version 0 are its own. `job`
// says all but noise and base. Fills `answer`, all but its number and the corrections of a method.
// A refusal (common/rollout/refusal.h) where the batcher gives one; INTERNAL where the policy
// throws, or predicts what is no command.
absl::StatusOr<SampledPrediction> ComputePrediction(Batcher& batcher, PredictionJob job,
                                                    const SessionSpec& spec, const ChunkKey& key,
                                                    PredictedChunk& answer);

}  // namespace robostress
