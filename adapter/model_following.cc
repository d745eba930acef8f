#include "adapter/model_following.h"

#include "adapter/shrinkage.h"
#include "common/check.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status FollowingOptions::Check() const {
  RS_RETURN_IF_ERROR(CheckOption("following_gain", gain, 0, 10));
  RS_RETURN_IF_ERROR(CheckOption("following_memory", memory, 1, 1e6));
  RS_RETURN_IF_ERROR(CheckOption("following_threshold", threshold, 0, 10));
  return CheckOption("following_limit", limit, 0, 10);
}

ModelFollowing::ModelFollowing(const FollowingOptions& options, const ResidualOptions& residual,
                               const NominalArmOptions& arm)
    : options_(options),
      axes_(options.axes == FollowingAxes::kHorizontal ? 2 : 3),
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
    const Eigen::VectorXf& asked =
        step.base_command.size() > 0 ? step.base_command : step.policy_command;
    const Vector6 nominal = arm_.Step(asked.head<6>().cast<double>(), step.before);
    shortfall_ *= 1 - 1 / options_.memory;
    if (chunk.IsMasked(i)) continue;
    shortfall_ +=
        nominal.head<3>() - AchievedDelta(step.before, StateAfter(chunk, i), residual_).head<3>();
  }
}

Eigen::VectorXd ModelFollowing::correction() const {
  Eigen::VectorXd correction = Eigen::VectorXd::Zero(6);
  const Eigen::VectorXd followed = shortfall_.head(axes_);
  const double share = KeptShare(followed.norm(), options_.threshold);
  correction.head(axes_) =
      (options_.gain * share * followed).cwiseMax(-options_.limit).cwiseMin(options_.limit);
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
