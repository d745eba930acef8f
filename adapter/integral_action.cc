#include "adapter/integral_action.h"

#include <cmath>

#include "adapter/shrinkage.h"
#include "common/check.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status IntegralOptions::Check() const {
  RS_RETURN_IF_ERROR(CheckOption("integral_rate", rate, 0, 1));
  RS_RETURN_IF_ERROR(CheckOption("integral_limit", limit, 0, 10));
  return CheckOption("integral_threshold", threshold, 0, 10);
}

IntegralAction::IntegralAction(const IntegralOptions& options, const ResidualOptions& residual,
                               const NominalArmOptions& arm)
    : options_(options),
      axes_(options.axes == IntegralAxes::kTranslation ? 3 : 6),
      residual_(residual),
      arm_(arm) {
  residual_.scale = ResidualScale::kCommand;
}

void IntegralAction::StartEpisode() {
  arm_.Reset();
  if (!options_.carry) estimate_.setZero();
}

void IntegralAction::Observe(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const Vector6 nominal = arm_.Step(step.sent_command.head<6>().cast<double>(), step.before);
    if (chunk.IsMasked(i)) continue;
    const Vector6 achieved = AchievedDelta(step.before, StateAfter(chunk, i), residual_);
    for (int axis = 0; axis < axes_; ++axis) {
      const double disturbance = (achieved[axis] - nominal[axis]) / residual_.tracking_gain;
      estimate_[axis] += options_.rate * (disturbance - estimate_[axis]);
    }
    estimate_ = estimate_.cwiseMax(-options_.limit).cwiseMin(options_.limit);
  }
}

Eigen::VectorXd IntegralAction::correction() const {
  return -estimate_.unaryExpr(
      [&](double axis) { return KeptShare(std::abs(axis), options_.threshold) * axis; });
}

Eigen::VectorXd IntegralAction::State() const {
  Eigen::VectorXd state(kStateSize);
  state << estimate_, arm_.state().goal, arm_.state().velocity;
  return state;
}

bool IntegralAction::Holds(const Eigen::VectorXd& state) const {
  return state.size() == kStateSize && (state.head<6>().array().abs() <= options_.limit).all() &&
         NominalArm::Holds({state.segment<6>(6), state.tail<6>()});
}

void IntegralAction::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == kStateSize);
  estimate_ = state.head<6>();
  arm_.set_state({state.segment<6>(6), state.tail<6>()});
}

}  // namespace robostress
