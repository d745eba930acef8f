#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "adapter/command_correction.h"
#include "common/deferred.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/session_spec.h"

namespace robostress {

struct MethodOptions;  // adapter/method_options.h

// INVALID_ARGUMENT names the method that needs weights, or an option of it that does not hold.
absl::Status CheckWithoutWeights(const SessionSetting& setting, const MethodOptions& method);

// Any policy with what a method does that needs no weights: gain, direct and integral correction,
// model following, smoothing. Its commands are, bit by bit, those of a session of our own server
// with that method around a policy that predicts the same; with every_step they follow the arm at
// every control step. A policy that learns what is sent (target: sent) is told the commands before
// smoothing: a filter that is learned and applied again has no end. One thread.
class CompensatedPolicy : public PolicyEndpoint {
 public:
  // `policy` outlives this and adapts nothing. Errors are those of CheckWithoutWeights.
  static absl::StatusOr<std::unique_ptr<CompensatedPolicy>> Create(PolicyEndpoint* policy,
                                                                   const SessionSetting& setting,
                                                                   const MethodOptions& method);

  const PolicySpec& spec() const override { return policy_->spec(); }
  absl::Status StartEpisode(const EpisodeKey& key) override;
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override;
  absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                              const RunningRows& running) override;
  // With every_step: the policy's row with what the correction is by now, smoothed.
  absl::StatusOr<Eigen::VectorXf> NextCommand(const PredictedChunk& predicted,
                                              const ExecutedChunk& so_far) override;
  // A chunk of another episode than the open one, or one that came before, teaches nothing; one
  // that nobody can have measured is INVALID_ARGUMENT, and nothing changes, as where `policy`
  // refuses it.
  absl::Status SendFeedback(ExecutedChunk executed) override;
  absl::StatusOr<SessionStats> Stats() override { return policy_->Stats(); }

 private:
  CompensatedPolicy(PolicyEndpoint* policy, const SessionSetting& setting,
                    const MethodOptions& method);
  Eigen::VectorXf Smoothed(Eigen::VectorXf command);
  absl::StatusOr<PredictedChunk> Corrected(absl::StatusOr<PredictedChunk> predicted);

  PolicyEndpoint* const policy_;
  const Deferred<MethodOptions> method_;
  const ResidualOptions residual_;
  CommandCorrection correction_;
  CommandCorrection running_;  // the same, with the steps of the chunk that is being executed
  std::optional<EpisodeKey> episode_;
  std::vector<Eigen::VectorXf> corrected_;  // of the chunk's rows, before smoothing
  Eigen::VectorXf issued_;  // the command before, with every_step; empty: an episode begins
  uint64_t learned_ = 0;    // sequence of the last chunk that was taken
};

}  // namespace robostress
