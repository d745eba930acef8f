#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "adapter/adam.h"
#include "adapter/lora.h"
#include "adapter/lora_options.h"
#include "adapter/update_guard.h"
#include "adapter/velocity_field.h"
#include "common/random.h"

namespace robostress {

// One buffered chunk: what the action expert saw and what it should have said. Immutable once
// shared.
struct TrainingChunk {
  PolicyContext
      context;  // B = 1: stored keys and values, so an update runs no vision-language forward
  torch::Tensor target;  // [K, d] model space
};

struct UpdateReport {
  bool applied = false;  // false: loss, gradient or step was not finite, or the guard refused the
                         // candidate; nothing changed
  std::optional<GuardVerdict> verdict;  // where a guard judged
  double loss = 0;                      // before the step
  double gradient_norm = 0;             // before the clip
  double distance = 0;                  // ||phi - phi_0||_2 after the step
  uint64_t version = 0;                 // updates applied
};

// phi and its optimiser, everything that an update changes.
struct LoraState {
  LoraWeights phi, phi_0;
  AdamState adam;
};

// What an update was made from, beside its batch.
struct UpdateContext {
  uint64_t feedback_sequence = 0;  // last chunk in when it was triggered, for people
  GuardOptions guard;
  std::vector<std::shared_ptr<const TrainingChunk>> held_out;  // for the guard
};

// Weights that predictions used or use.
struct PublishedVersion {
  std::shared_ptr<const LoraWeights> weights;
  double distance = 0;             // ||phi - phi_0||_2
  double loss = 0;                 // of its update, before the step
  uint64_t feedback_sequence = 0;  // as UpdateContext
  bool pinned = false;             // kept whatever is published after it
};

// The online adapter of one session. snapshot() may be called from any thread at any time and never
// waits for an update; the other functions are for one thread at a time.
class LoraAdapter {
 public:
  // Versions held: phi_0, the last kHistory published and at most kMaxPinned pinned ones.
  static constexpr size_t kHistory = 16, kMaxPinned = 16;

  // `field` must outlive the adapter. `session` keys phi_0 and every draw of an update.
  static absl::StatusOr<std::unique_ptr<LoraAdapter>> Create(const VelocityField* field,
                                                             const LoraOptions& options,
                                                             const StreamKey& session);

  // The last published weights.
  std::shared_ptr<const LoraWeights> snapshot() const ABSL_LOCKS_EXCLUDED(mu_);
  // ||phi - phi_0||_2 of the last published weights.
  double distance() const ABSL_LOCKS_EXCLUDED(mu_);

  // One Adam step on the compensation loss of `batch`; publishes a new snapshot. A function of the
  // state, `batch` and `index` alone.
  absl::StatusOr<UpdateReport> Update(
      uint64_t index, const std::vector<std::shared_ptr<const TrainingChunk>>& batch,
      const UpdateContext& context = {}) ABSL_LOCKS_EXCLUDED(mu_);

  LoraState Export() const ABSL_LOCKS_EXCLUDED(mu_);
  // Whether Import would take it: tensors of the right shapes.
  absl::Status CheckShapes(const LoraState& state) const;
  absl::Status Import(const LoraState& state) ABSL_LOCKS_EXCLUDED(mu_);
  // Back to `version` (0: phi_0) with a new Adam state; later versions are forgotten.
  // FAILED_PRECONDITION while one of them is pinned.
  absl::Status Rollback(uint64_t version) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status CheckRollback(uint64_t version) const ABSL_LOCKS_EXCLUDED(mu_);

  // Held versions, oldest first; phi_0 first.
  std::vector<PublishedVersion> Versions() const ABSL_LOCKS_EXCLUDED(mu_);
  // NOT_FOUND: not held; RESOURCE_EXHAUSTED: kMaxPinned others are pinned.
  absl::Status Pin(uint64_t version, bool pinned) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status CheckPin(uint64_t version, bool pinned) const ABSL_LOCKS_EXCLUDED(mu_);
  // After Import: the versions held when the state was exported, the published one last.
  absl::Status RestoreVersions(std::vector<PublishedVersion> versions) ABSL_LOCKS_EXCLUDED(mu_);

  const LoraWeights& phi_0() const { return phi_0_; }

 private:
  LoraAdapter(const VelocityField* field, const LoraOptions& options, const StreamKey& session);
  void Publish(LoraWeights phi, double loss, uint64_t feedback_sequence) ABSL_LOCKS_EXCLUDED(mu_);
  void Publish(PublishedVersion version) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  void TrimHistory() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const VelocityField* field_;
  const LoraOptions options_;
  const StreamKey session_;
  LoraWeights phi_0_;  // changed with mu_ held, so that Versions() may read it
  AdamState adam_;

  mutable absl::Mutex mu_;
  std::shared_ptr<const LoraWeights> published_ ABSL_GUARDED_BY(mu_);
  std::deque<PublishedVersion> history_ ABSL_GUARDED_BY(mu_);  // newest last, published_ included
  double distance_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace robostress
