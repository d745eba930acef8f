#include "adapter/integral_action.h"

#include <cmath>

#include "adapter/shrinkage.h"
#include "common/check.h"

namespace robostress {

IntegralAction::IntegralAction(const MethodOptions& method, const ResidualOptions& residual,
                               const NominalArmOptions& arm)
    : rate_(method.integral_rate),
      limit_(method.integral_limit),
      threshold_(method.integral_threshold),
      gain_(method.tracking_gain),
      axes_(method.integral_axes == IntegralAxes::kTranslation ? 3 : 6),
      carry_(method.integral_carry),
      residual_(residual),
      arm_(arm) {
  residual_.scale = ResidualScale::kCommand;
}

void IntegralAction::StartEpisode() {
  arm_.Reset();
  if (!carry_) estimate_.setZero();
}

void IntegralAction::Observe(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const Vector6 nominal = arm_.Step(chunk.steps[i].sent_command.head<6>().cast<double>());
    if (chunk.IsMasked(i)) continue;
    const Vector6 achieved = AchievedDelta(chunk.steps[i].before, StateAfter(chunk, i), residual_);
    for (int axis = 0; axis < axes_; ++axis) {
      const double disturbance = (achieved[axis] - nominal[axis]) / gain_;
      estimate_[axis] += rate_ * (disturbance - estimate_[axis]);
    }
    estimate_ = estimate_.cwiseMax(-limit_).cwiseMin(limit_);
  }
}

IntegralAction::Vector6 IntegralAction::correction() const {
  return -estimate_.unaryExpr(
      [&](double axis) { return KeptShare(std::abs(axis), threshold_) * axis; });
}

Eigen::VectorXd IntegralAction::State() const {
  Eigen::VectorXd state(kStateSize);
  state << estimate_, arm_.state().goal, arm_.state().velocity;
  return state;
}

bool IntegralAction::Holds(const Eigen::VectorXd& state) const {
  return state.size() == kStateSize && (state.head<6>().array().abs() <= limit_).all() &&
         NominalArm::Holds({state.segment<6>(6), state.tail<6>()});
}

void IntegralAction::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == kStateSize);
  estimate_ = state.head<6>();
  arm_.set_state({state.segment<6>(6), state.tail<6>()});
}

}  // namespace robostress
