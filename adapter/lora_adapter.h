#pragma once

#include <deque>
#include <memory>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "adapter/adam.h"
#include "adapter/lora.h"
#include "adapter/velocity_field.h"
#include "common/method_options.h"
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
  bool applied = false;      // false: loss or gradient was not finite, nothing changed
  double loss = 0;           // before the step
  double gradient_norm = 0;  // before the clip
  double distance = 0;       // ||phi - phi_0||_2 after the step
  uint64_t version = 0;      // updates applied
};

// phi and its optimiser, everything that an update changes.
struct LoraState {
  LoraWeights phi, phi_0;
  AdamState adam;
};

// The online adapter of one session. snapshot() may be called from any thread at any time and never
// waits for an update; the other functions are for one thread at a time.
class LoraAdapter {
 public:
  static constexpr size_t kHistory = 16;  // versions that Rollback can reach, beside phi_0

  // `field` must outlive the adapter. `session` keys phi_0 and every draw of an update.
  static absl::StatusOr<std::unique_ptr<LoraAdapter>> Create(const VelocityField* field,
                                                             const MethodOptions& options,
                                                             const StreamKey& session);

  // The last published weights.
  std::shared_ptr<const LoraWeights> snapshot() const ABSL_LOCKS_EXCLUDED(mu_);
  // ||phi - phi_0||_2 of the last published weights.
  double distance() const ABSL_LOCKS_EXCLUDED(mu_);

  // One Adam step on the compensation loss of `batch`; publishes a new snapshot. A function of the
  // state, `batch` and `index` alone.
  absl::StatusOr<UpdateReport> Update(
      uint64_t index, const std::vector<std::shared_ptr<const TrainingChunk>>& batch)
      ABSL_LOCKS_EXCLUDED(mu_);

  LoraState Export() const ABSL_LOCKS_EXCLUDED(mu_);
  // Refuses tensors of other shapes.
  absl::Status Import(const LoraState& state) ABSL_LOCKS_EXCLUDED(mu_);
  // Back to `version` (0: phi_0) with a new Adam state.
  absl::Status Rollback(uint64_t version) ABSL_LOCKS_EXCLUDED(mu_);

  const LoraWeights& phi_0() const { return phi_0_; }

 private:
  LoraAdapter(const VelocityField* field, const MethodOptions& options, const StreamKey& session);
  void Publish(LoraWeights phi) ABSL_LOCKS_EXCLUDED(mu_);

  const VelocityField* field_;
  const MethodOptions options_;
  const StreamKey session_;
  LoraWeights phi_0_;
  AdamState adam_;

  mutable absl::Mutex mu_;
  std::shared_ptr<const LoraWeights> published_ ABSL_GUARDED_BY(mu_);
  std::deque<std::shared_ptr<const LoraWeights>> history_
      ABSL_GUARDED_BY(mu_);  // newest last, published_ included
  double distance_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace robostress
