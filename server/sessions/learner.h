#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "adapter/adaptation_state.h"
#include "adapter/command_correction.h"
#include "adapter/feedback_buffer.h"
#include "adapter/lora_adapter.h"
#include "adapter/lora_options.h"
#include "adapter/measured_chunk.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "adapter/update_schedule.h"
#include "common/random.h"
#include "common/rollout/session_spec.h"
#include "server/inference/prefix_store.h"
#include "server/policies/policy.h"
#include "server/sessions/prediction.h"

namespace robostress {

// What a session learns: the buffer, when an update is due, from what it is made, and the adapter.
// A method that does not adapt has no adapter; what it would learn from is passed over.
//
// Its owner locks, but for published(), updates_applied(), distance(), Versions() and Compute().
class Learner {
 public:
  // What one chunk teaches, ready to be taken.
  struct Lesson {
    std::optional<BufferedChunk> training;  // where the method adapts
    NominalArm arm;                         // after the chunk
    EpisodeKey episode;
  };
  // An update that is due, of the buffer as it was then.
  struct Update {
    uint64_t index = 0;     // keys its draws
    uint64_t sequence = 0;  // the last feedback before it
    std::vector<BufferedChunk> batch, held_out;
  };
  struct Counters {
    uint64_t refused = 0;  // loss or gradient was not finite
    uint64_t guarded = 0;  // refused by the guard
    uint64_t rollbacks = 0;
  };

  // `spec` outlives it. As LoraAdapter::Create.
  static absl::StatusOr<std::unique_ptr<Learner>> Create(const SessionSpec* spec,
                                                         std::shared_ptr<const FlowPolicy> policy,
                                                         std::shared_ptr<PrefixStore> prefixes,
                                                         const GuardOptions& guard);

  bool adapts() const { return adapter_ != nullptr; }
  // FAILED_PRECONDITION where the method does not adapt; `purpose` says what for.
  absl::Status RequireAdapter(const char* purpose) const;

  // Eq. 1 and 2: what a chunk would teach. Nothing changes.
  absl::StatusOr<Lesson> Prepare(const MeasuredChunk& measured, const Prediction& prediction) const;
  // Takes it as feedback `sequence`. The update that it triggers counts as pending until Finish.
  std::optional<Update> Learn(Lesson lesson, uint64_t sequence);
  // Clears the buffer after feedback `last_sequence`: now, if it is in.
  void AddBoundary(uint64_t last_sequence, uint64_t in);
  // Whether one more boundary may wait for its feedback.
  absl::Status CheckBoundary(uint64_t last_sequence, uint64_t in) const;

  // Computes and publishes it, one at a time. May throw what LibTorch throws.
  absl::StatusOr<UpdateReport> Compute(const Update& update);
  // Counts what came of it. An error is the session's end.
  absl::Status Finish(const Update& update, const absl::StatusOr<UpdateReport>& report);
  // It is not computed any more.
  void Drop() { --pending_; }
  int pending() const { return pending_; }

  // --- the adaptation as a value
  // All but the buffer, task and feedback_sequence.
  AdaptationState State() const;
  std::vector<BufferedChunk> Buffer() const;
  // With the keys and values, rebuilt where the store dropped them.
  absl::StatusOr<std::vector<std::shared_ptr<const TrainingChunk>>> WithPrefixes(
      const std::vector<BufferedChunk>& chunks) const;
  // Of this policy and method; for shapes beyond the file's own ask CheckShapes. `name` is for
  // messages.
  absl::StatusOr<AdaptationState> Read(const std::string& name,
                                       const std::string& safetensors) const;
  absl::Status CheckShapes(const AdaptationState& state) const;
  absl::Status Apply(const AdaptationState& state);
  // A snapshot's, after Apply.
  absl::Status Restore(const std::vector<BufferedChunk>& buffer,
                       const std::vector<PublishedVersion>& versions,
                       const std::vector<uint64_t>& boundaries, const Counters& counters);

  // --- versions; as LoraAdapter's
  absl::Status CheckRollback(uint64_t version) const { return adapter_->CheckRollback(version); }
  absl::Status Rollback(uint64_t version);
  absl::Status CheckPin(uint64_t version, bool pinned) const;
  absl::Status Pin(uint64_t version, bool pinned) { return adapter_->Pin(version, pinned); }
  std::vector<PublishedVersion> Versions() const;  // none where the method does not adapt

  std::shared_ptr<const LoraWeights> published() const { return adapter_->snapshot(); }
  uint64_t updates_applied() const { return adapts() ? published()->version : 0; }
  double distance() const { return adapts() ? adapter_->distance() : 0; }
  int buffered() const { return buffer_.size(); }
  double last_loss() const { return last_loss_; }
  const Counters& counters() const { return counters_; }
  const std::set<uint64_t>& boundaries() const { return boundaries_; }

 private:
  Learner(const SessionSpec* spec, std::shared_ptr<const FlowPolicy> policy,
          std::shared_ptr<PrefixStore> prefixes, const GuardOptions& guard);
  // [K, d] model space; the prediction itself where a value would not be finite.
  absl::StatusOr<torch::Tensor> SentTargetOf(const ExecutedChunk& executed,
                                             const Prediction& prediction) const;
  absl::StatusOr<BufferedChunk> MakeTraining(const MeasuredChunk& measured,
                                             const Prediction& prediction, NominalArm& arm) const;
  Update MakeUpdate(uint64_t sequence);
  void Clear();

  const SessionSpec* const spec_;
  const std::shared_ptr<const FlowPolicy> policy_;
  const std::shared_ptr<PrefixStore> prefixes_;
  const GuardOptions guard_;
  const StreamKey key_;
  const ResidualOptions residual_;
  const LoraOptions lora_;
  std::unique_ptr<LoraAdapter> adapter_;  // null where the method does not adapt

  FeedbackBuffer<BufferedChunk> buffer_;
  UpdateSchedule schedule_;
  std::set<uint64_t> boundaries_;  // clear the buffer after these feedback numbers
  NominalArm arm_;
  EpisodeKey arm_episode_{-1, -1};
  uint64_t triggers_ = 0;
  int pending_ = 0;
  double last_loss_ = 0;
  Counters counters_;
};

}  // namespace robostress
