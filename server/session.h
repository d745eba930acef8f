#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "adapter/feedback_buffer.h"
#include "adapter/lora_adapter.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "adapter/update_schedule.h"
#include "common/random.h"
#include "common/rpc/session_spec.h"
#include "common/types.h"
#include "server/adaptation.h"
#include "server/batcher.h"
#include "server/policy.h"
#include "server/prefix_store.h"

namespace robostress {

// What sessions share. Must outlive them.
struct SessionResources {
  std::shared_ptr<const FlowPolicy> policy;
  AdaptationLoop* adaptation = nullptr;
  Batcher* inference = nullptr;
  absl::Duration lockstep_timeout =
      absl::Seconds(120);  // for feedback that was announced and does not come
  std::shared_ptr<PrefixStore> prefixes = std::make_shared<PrefixStore>();
};

// How one prediction is served; decides no result.
struct PredictOptions {
  Priority priority = Priority::kUnspecified;          // robots: async sessions
  absl::Duration deadline = absl::InfiniteDuration();  // from now on; async only
  std::function<bool()> cancelled;                     // PredictionJob
};

struct FeedbackResult {
  uint64_t sequence = 0;  // every chunk up to this one is in
  uint64_t updates_applied = 0;
};

struct SessionCounters {
  SessionStats stats;
  int buffered_chunks = 0;
  uint64_t predictions = 0;
  PrefixStore::Counters prefixes;  // of all sessions that share the store
  uint64_t updates_refused = 0;    // loss or gradient was not finite
  uint64_t predictions_dropped =
      0;  // kept for feedback that had not come when kMaxOutstanding others had been made
};

// The identity that keys phi_0 and every draw of an update. The sampling noise has a key of its
// own.
std::string SessionIdentity(const SessionSpec& spec);
// Key of the noise of one prediction: (noise stream, seed, suite, task, episode, chunk) and nothing
// else, so it is equal for every method and scenario.
StreamKey NoiseKey(const SessionSpec& spec, int task, int episode, int chunk);

// One robot with one adapter. All functions may be called from any thread.
//
// An update is a function of the feedback sequence: feedback is taken in order of its sequence
// numbers, an update is triggered by its 32nd, 40th, 48th ... chunk since the last clear and
// samples from the buffer as it was then; where the update runs and when it is published only
// decides which prediction sees it first. Lockstep removes that freedom too.
class Session : public std::enable_shared_from_this<Session> {
 public:
  static constexpr size_t kMaxOutstanding =
      64;  // predictions kept for their feedback; the oldest are dropped
  static constexpr int kMaxPendingUpdates = 8;  // then Feedback waits

  // Refuses method options that make no sense together. `owner` is unique among the sessions of an
  // AdaptationLoop.
  static absl::StatusOr<std::shared_ptr<Session>> Create(const SessionSpec& spec,
                                                         const SessionResources& resources,
                                                         uint64_t owner);

  const PolicySpec& policy_spec() const { return resources_.policy->spec(); }
  const SessionSpec& spec() const { return spec_; }

  // A task other than the last one is a boundary: the buffer is cleared after feedback
  // `last_sequence`.
  absl::Status StartEpisode(int task, int episode, uint64_t last_sequence) ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int task, int episode,
                                         int chunk, uint64_t last_sequence,
                                         const PredictOptions& options = {})
      ABSL_LOCKS_EXCLUDED(mu_);
  // A sequence number that is in already is acknowledged and ignored; a gap is refused.
  absl::StatusOr<FeedbackResult> Feedback(const ExecutedChunk& executed) ABSL_LOCKS_EXCLUDED(mu_);

  // Lockstep: with every update due.
  absl::StatusOr<SessionCounters> Counters() ABSL_LOCKS_EXCLUDED(mu_);
  // The adaptation with every update due as a safetensors file (adapter/README.md).
  absl::StatusOr<AdapterState> Export() ABSL_LOCKS_EXCLUDED(mu_);
  // Replaces the adaptation; feedback goes on after its sequence number. INVALID_ARGUMENT if it is
  // damaged or belongs to another policy or method.
  absl::StatusOr<FeedbackResult> Import(const std::string& safetensors) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Rollback(uint64_t version) ABSL_LOCKS_EXCLUDED(mu_);

  // Ends every wait with CANCELLED, now and later.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // What must be remembered of a prediction until its feedback arrives.
  struct Prediction {
    int task = 0, episode = 0, chunk = 0;
    torch::Tensor raw;    // [K, d] model space; undefined where the method does not adapt
    torch::Tensor state;  // PolicyContext::state
    std::shared_ptr<const PrefixStore::Prefix> prefix;  // as above
    Eigen::MatrixXf base;  // [K, action_dim] of the unadapted policy; target: intent only
  };
  // A training chunk while nothing computes with it.
  struct BufferedChunk {
    std::shared_ptr<const PrefixStore::Prefix> prefix;
    torch::Tensor target;  // [K, d] model space
  };

  Session(const SessionSpec& spec, const SessionResources& resources, uint64_t owner);

  bool IdleOrCancelled() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return cancelled_ || pending_updates_ == 0;
  }
  // Waits until feedback `sequence` is in and nothing is pending.
  absl::Status AwaitLearned(uint64_t sequence) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ClearBuffer() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Eq. 1 and 2: the training chunk of an executed chunk.
  absl::StatusOr<BufferedChunk> MakeTrainingChunk(const ExecutedChunk& executed,
                                                  const Prediction& prediction)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // With the keys and values, rebuilt where the store dropped them.
  absl::StatusOr<std::vector<std::shared_ptr<const TrainingChunk>>> WithPrefixes(
      const std::vector<BufferedChunk>& chunks) const;
  void TriggerUpdate() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void RunUpdate(uint64_t index, const std::vector<BufferedChunk>& batch) ABSL_LOCKS_EXCLUDED(mu_);
  uint64_t updates_applied() const {
    return adapter_ == nullptr ? 0 : adapter_->snapshot()->version;
  }

  const SessionSpec spec_;
  const SessionResources resources_;
  const uint64_t owner_;
  const StreamKey key_;
  const ResidualOptions residual_options_;
  std::unique_ptr<LoraAdapter> adapter_;  // null where the method does not adapt

  absl::Mutex mu_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
  absl::Status failure_ ABSL_GUARDED_BY(mu_);  // an update threw: the session computes no further
  std::optional<std::pair<int, int>> episode_ ABSL_GUARDED_BY(mu_);  // (task, episode) now
  std::set<uint64_t> boundaries_
      ABSL_GUARDED_BY(mu_);  // clear the buffer after these feedback numbers
  uint64_t feedback_sequence_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t feedback_chunks_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t next_prediction_ ABSL_GUARDED_BY(mu_) = 1;
  uint64_t predictions_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t predictions_dropped_ ABSL_GUARDED_BY(mu_) = 0;
  std::map<uint64_t, Prediction> outstanding_ ABSL_GUARDED_BY(mu_);
  Eigen::VectorXd direct_correction_
      ABSL_GUARDED_BY(mu_);  // [action_dim] or empty: none yet in this episode
  FeedbackBuffer<BufferedChunk> buffer_ ABSL_GUARDED_BY(mu_);
  UpdateSchedule schedule_ ABSL_GUARDED_BY(mu_);
  uint64_t triggers_ ABSL_GUARDED_BY(mu_) = 0;
  int pending_updates_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t updates_refused_ ABSL_GUARDED_BY(mu_) = 0;
  double last_loss_ ABSL_GUARDED_BY(mu_) = 0;
  NominalArm arm_ ABSL_GUARDED_BY(mu_);
  std::pair<int, int> arm_episode_ ABSL_GUARDED_BY(mu_) = {-1, -1};
};

}  // namespace robostress
