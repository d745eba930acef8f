#include "robot_client/homing_endpoint.h"

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

// Above every number that a server gives.
constexpr uint64_t kFirstHomingPrediction = uint64_t{1} << 40;

}  // namespace

absl::Status HomingEndpoint::StartEpisode(const EpisodeKey& key) {
  homing_ = key.episode == kHomingEpisode;
  return homing_ ? absl::OkStatus() : policy_->StartEpisode(key);
}

absl::StatusOr<PredictedChunk> HomingEndpoint::Predict(const Observation& observation, int chunk) {
  if (!homing_) return policy_->Predict(observation, chunk);
  double longest = 0;  // way of a joint [rad]
  for (int j = 0; j < axes_.joints; ++j)
    longest = std::max(longest, std::abs(home_[j] - observation.proprioception[j]));
  PredictedChunk way;
  way.prediction_id = kFirstHomingPrediction + ++predictions_;
  way.actions.resize(spec().horizon, axes_.count());
  for (int row = 0; row < spec().horizon; ++row) {
    const double share = std::min(1.0, (row + 1) * kJointSpeed * period_s_ / (longest + 1e-9));
    for (int j = 0; j < axes_.joints; ++j) {
      const double from = observation.proprioception[j];
      way.actions(row, j) = static_cast<float>(from + share * (home_[j] - from));
    }
    if (axes_.gripper)
      way.actions(row, axes_.opening()) = static_cast<float>(home_[axes_.opening()]);
  }
  way.policy_actions = way.actions;
  return way;
}

absl::Status HomingEndpoint::SendFeedback(ExecutedChunk executed) {
  if (executed.episode == kHomingEpisode) return absl::OkStatus();
  executed.sequence = sequence_ + 1;
  const absl::Status status = policy_->SendFeedback(std::move(executed));
  const bool refused = absl::IsFailedPrecondition(status) || absl::IsInvalidArgument(status) ||
                       absl::IsNotFound(status) || absl::IsDataLoss(status);
  if (!refused) ++sequence_;
  return status;
}

bool IsHome(const ArmAxes& axes, const ArmVector& position, const ArmVector& home) {
  for (int j = 0; j < axes.joints; ++j) {
    if (std::abs(position[j] - home[j]) > HomingEndpoint::kJointsNear) return false;
  }
  return std::abs(position[axes.opening()] - home[axes.opening()]) < HomingEndpoint::kOpeningNear;
}

}  // namespace robostress
