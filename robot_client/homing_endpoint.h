#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include "common/rollout/policy_endpoint.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// The episode number under which an arm is driven to its starting pose between episodes.
inline constexpr int kHomingEpisode = -1;

// A policy, and the way home: in an episode kHomingEpisode chunks lead straight to `home`, whatever
// the cameras show, through the client's player, limiter and watchdogs as any chunk; the policy
// hears nothing of it, neither predictions nor feedback. One thread.
class HomingEndpoint : public PolicyEndpoint {
 public:
  static constexpr double kJointSpeed = 0.6;    // [rad/s]
  static constexpr double kJointsNear = 0.03;   // [rad]
  static constexpr double kOpeningNear = 0.01;  // [m]

  // `home`: absolute joints [rad] and opening [m]; `period_s` between rows.
  HomingEndpoint(std::unique_ptr<PolicyEndpoint> policy, const ArmAxes& axes, const ArmVector& home,
                 double period_s)
      : policy_(std::move(policy)), axes_(axes), home_(home), period_s_(period_s) {}

  const PolicySpec& spec() const override { return policy_->spec(); }
  absl::Status StartEpisode(const EpisodeKey& key) override;
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override;
  // Drops what was executed on the way home; the rest goes on with sequence numbers of its own.
  absl::Status SendFeedback(ExecutedChunk executed) override;
  absl::StatusOr<SessionStats> Stats() override { return policy_->Stats(); }

 private:
  const std::unique_ptr<PolicyEndpoint> policy_;
  const ArmAxes axes_;
  const ArmVector home_;
  const double period_s_;
  bool homing_ = false;
  uint64_t predictions_ = 0;  // on the way home
  uint64_t sequence_ = 0;     // of the policy's feedback
};

// Whether an arm at `position` is where homing leads.
bool IsHome(const ArmAxes& axes, const ArmVector& position, const ArmVector& home);

}  // namespace robostress
