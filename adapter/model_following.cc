#include "adapter/model_following.h"

#include "adapter/shrinkage.h"
#include "common/check.h"

namespace robostress {

ModelFollowing::ModelFollowing(const MethodOptions& method, const ResidualOptions& residual,
                               const NominalArmOptions& arm)
    : gain_(method.following_gain),
      keep_(1 - 1 / method.following_memory),
      threshold_(method.following_threshold),
      limit_(method.following_limit),
      axes_(method.following_axes == FollowingAxes::kHorizontal ? 2 : 3),
      residual_(residual),
      arm_(arm) {
  residual_.scale = ResidualScale::kCommand;
}

void ModelFollowing::StartEpisode() {
  arm_.Reset();
  shortfall_.setZero();
}

void ModelFollowing::Observe(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const Vector6 nominal = arm_.Step(step.policy_command.head<6>().cast<double>());
    shortfall_ *= keep_;
    if (chunk.IsMasked(i)) continue;
    shortfall_ +=
        nominal.head<3>() - AchievedDelta(step.before, StateAfter(chunk, i), residual_).head<3>();
  }
}

ModelFollowing::Vector6 ModelFollowing::correction() const {
  Vector6 correction = Vector6::Zero();
  const Eigen::VectorXd followed = shortfall_.head(axes_);
  const double share = KeptShare(followed.norm(), threshold_);
  correction.head(axes_) = (gain_ * share * followed).cwiseMax(-limit_).cwiseMin(limit_);
  return correction;
}

Eigen::VectorXd ModelFollowing::State() const {
  Eigen::VectorXd state(kStateSize);
  state << shortfall_, arm_.state().goal, arm_.state().velocity;
  return state;
}

bool ModelFollowing::Holds(const Eigen::VectorXd& state) const {
  return state.size() == kStateSize && (state.head<3>().array().abs() <= kMaxShortfall).all() &&
         NominalArm::Holds({state.segment<6>(3), state.tail<6>()});
}

void ModelFollowing::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == kStateSize);
  shortfall_ = state.head<3>();
  arm_.set_state({state.segment<6>(3), state.tail<6>()});
}

}  // namespace robostress
