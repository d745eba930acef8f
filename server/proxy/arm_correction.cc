#include "server/proxy/arm_correction.h"

#include <algorithm>

#include "adapter/measured_chunk.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/policy_endpoint.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr Eigen::Index kGroup = DisturbanceObserver::kMaxJoints;

ResidualOptions ResidualFor(const ArmProfile& profile, const MethodOptions& method) {
  ResidualOptions options = ResidualOptionsOf(
      method, profile.joint_space() ? ResidualSpace::kJoint : ResidualSpace::kEndEffector);
  const ActionLayout& action = profile.action;
  options.translation_scale =
      action.translation_full > 0 ? action.translation_full : action.translation_unit;
  options.rotation_scale = action.rotation_full > 0 ? action.rotation_full : action.rotation_unit;
  return options;
}

DisturbanceObserverOptions ObserverFor(const ArmProfile& profile) {
  DisturbanceObserverOptions options;
  options.bandwidth = profile.observer_bandwidth;
  options.max_correction = profile.correction_limit().maxCoeff();
  options.anti_windup = true;  // a block that is gone is forgotten at once
  options.min_dt_s = 0;
  options.max_dt_s = 10;  // it is asked once a chunk
  return options;
}

}  // namespace

ArmCorrection::ArmCorrection(const ArmProfile& profile, const MethodOptions& method)
    : columns_(static_cast<Eigen::Index>(profile.columns().size())),
      residual_(ResidualFor(profile, method)),
      correction_(method, residual_, profile.nominal_arm()) {
  if (!method.observer) return;
  for (Eigen::Index at = 0; at < columns_; at += kGroup)
    observers_.emplace_back(ObserverFor(profile));
  StartEpisode();
}

void ArmCorrection::StartEpisode() {
  correction_.StartEpisode();
  for (size_t i = 0; i < observers_.size(); ++i) {
    const auto joints = std::min(kGroup, columns_ - static_cast<Eigen::Index>(i) * kGroup);
    observers_[i].Reset();
    observers_[i].CorrectUnmeasured(DisturbanceObserver::Joints::Zero(joints));  // an estimate of 0
  }
}

absl::Status ArmCorrection::Observe(const ArmMotion& motion, double dt_s) {
  PolicySpec policy;
  policy.name = "behind the proxy";
  policy.action_dim = static_cast<int>(motion.chunk.steps.front().sent_command.size());
  policy.horizon = WireLimits::kHorizon;
  RS_ASSIGN_OR_RETURN(const MeasuredChunk measured,
                      MeasuredChunk::Create(motion.chunk, policy, residual_));
  if (measured.steps_impossible() > 0)
    return absl::InvalidArgumentError("no arm moves like that between two control steps");
  correction_.Observe(measured.usable());
  const Eigen::VectorXd& q = motion.chunk.final_state.q;
  const Eigen::VectorXd sent = motion.chunk.steps.back().sent_command.head(columns_).cast<double>();
  for (size_t i = 0; i < observers_.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i) * kGroup;
    const auto joints = std::min(kGroup, columns_ - at);
    observers_[i].Applied(sent.segment(at, joints));
    observers_[i].Correct(sent.segment(at, joints), q.segment(at, joints), dt_s);
  }
  return absl::OkStatus();
}

Eigen::VectorXd ArmCorrection::Value() const {
  Eigen::VectorXd value = Eigen::VectorXd::Zero(columns_);
  const Eigen::VectorXd learned = correction_.Value();
  if (learned.size() > 0) value += learned.head(columns_);
  for (size_t i = 0; i < observers_.size(); ++i) {
    const DisturbanceObserver::Joints& estimate = observers_[i].estimate();
    value.segment(static_cast<Eigen::Index>(i) * kGroup, estimate.size()) -= estimate;
  }
  return value;
}

Eigen::VectorXd CorrectionLimiter::Next(const Eigen::VectorXd& now,
                                        const Eigen::VectorXd& wanted) const {
  const Eigen::VectorXd target = wanted.cwiseMax(-limit_).cwiseMin(limit_);
  return now + (target - now).cwiseMax(-step_).cwiseMin(step_);
}

}  // namespace robostress
