#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <optional>

#include "absl/time/time.h"
#include "common/rollout/chunk_key.h"
#include "common/rollout/session_spec.h"

// What passes between a session and who calls it. No LibTorch, no protobuf.
namespace robostress {

// How one prediction is served; but for `running` it decides no result.
struct PredictOptions {
  Priority priority = Priority::kUnspecified;          // ROBOT in async, SIMULATION in lockstep
  absl::Duration deadline = absl::InfiniteDuration();  // from now on; async only
  std::function<bool()> cancelled;                     // PredictionJob
  std::optional<RunningRows> running;                  // what the prediction goes on from
};

struct FeedbackResult {
  uint64_t sequence = 0;  // every chunk up to this one is in
  uint64_t updates_applied = 0;
  bool durable = false;    // and on disk
  bool duplicate = false;  // it was in already
  // Of a chunk that was taken, for who shows it: MeasuredChunk::residual [steps, action_dim], and
  // where its adapter stands.
  Eigen::MatrixXd residual;
  double adapter_distance = 0, last_loss = 0;
};

// Where a client that comes back goes on.
struct SessionPosition {
  uint64_t feedback_sequence = 0;   // watermark
  uint64_t last_prediction_id = 0;  // 0: none yet
  uint64_t updates_applied = 0;
  std::optional<EpisodeKey> episode;  // of the last StartEpisode
  int next_chunk = 0;                 // after the last that was predicted in it
  // From feedback, or from an adapter that was imported.
  bool learned() const { return feedback_sequence > 0 || updates_applied > 0; }
};

}  // namespace robostress
