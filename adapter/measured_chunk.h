#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "absl/status/statusor.h"
#include "adapter/residual.h"
#include "common/rollout/chunk_key.h"
#include "common/types.h"

namespace robostress {

// An executed chunk where it arrives: checked once, measured once, and carried on so to learner,
// correction, telemetry and journal. Immutable; the reported chunk outlives it.
class MeasuredChunk {
 public:
  // `options` are the session's. INVALID_ARGUMENT names step, field and value.
  static absl::StatusOr<MeasuredChunk> Create(const ExecutedChunk& reported,
                                              const PolicySpec& policy,
                                              const ResidualOptions& options);
  static absl::StatusOr<MeasuredChunk> Create(ExecutedChunk&& reported, const PolicySpec& policy,
                                              const ResidualOptions& options) = delete;

  // As it was sent: what the journal holds.
  const ExecutedChunk& reported() const { return *reported_; }
  // With the steps masked that no robot can have measured (adapter/plausible_motion.h): what
  // anything learns from.
  const ExecutedChunk& usable() const { return masked_ ? *masked_ : *reported_; }
  // Eq. 1 of `usable` against the policy's own commands [steps, action_dim]; masked rows are 0.
  const Eigen::MatrixXd& residual() const { return residual_; }
  uint64_t steps_masked() const { return steps_masked_; }          // by the client
  uint64_t steps_impossible() const { return steps_impossible_; }  // by the server, of the others

 private:
  explicit MeasuredChunk(const ExecutedChunk& reported) : reported_(&reported) {}

  const ExecutedChunk* reported_;
  std::optional<ExecutedChunk> masked_;  // where some step is impossible
  Eigen::MatrixXd residual_;
  uint64_t steps_masked_ = 0, steps_impossible_ = 0;
};

}  // namespace robostress
