#pragma once

#include <Eigen/Core>
#include <functional>
#include <utility>

#include "common/rollout/policy_endpoint.h"

namespace robostress {

// A scripted expert as a policy: it reads the task's true state, sees no image, and decides anew
// at every control step.
class ExpertPolicy : public PolicyEndpoint {
 public:
  // `decide`: the command of now, [action_dim]; `start`: at the beginning of an episode.
  explicit ExpertPolicy(
      std::function<Eigen::VectorXf()> decide, std::function<void()> start = [] {})
      : decide_(std::move(decide)), start_(std::move(start)) {
    spec_.name = "expert";
    spec_.horizon = 1;
    spec_.execute_steps = 1;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override {
    start_();
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    PredictedChunk chunk;
    chunk.prediction_id = ++predictions_;
    chunk.actions = decide_().transpose();
    chunk.policy_actions = chunk.base_actions = chunk.actions;
    return chunk;
  }
  absl::Status SendFeedback(ExecutedChunk) override {
    ++stats_.feedback_chunks;
    return absl::OkStatus();
  }
  absl::StatusOr<SessionStats> Stats() override { return stats_; }

 private:
  const std::function<Eigen::VectorXf()> decide_;
  const std::function<void()> start_;
  PolicySpec spec_;
  SessionStats stats_;
  uint64_t predictions_ = 0;
};

}  // namespace robostress
