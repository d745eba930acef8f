#include "adapter/leaky_goal.h"

#include "common/check.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status LeakyGoalOptions::Check() const {
  RS_RETURN_IF_ERROR(CheckOption("goal_memory", memory, 0, 1));
  return CheckOption("goal_limit", limit, 0, 10);
}

LeakyGoal::LeakyGoal(const LeakyGoalOptions& options, const ResidualOptions& residual,
                     const NominalArmOptions& /*arm*/)
    : options_(options), residual_(residual) {
  residual_.scale = ResidualScale::kCommand;
}

void LeakyGoal::Observe(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    if (chunk.IsMasked(i)) continue;
    const ExecutedStep& step = chunk.steps[i];
    const Vector6 goal = step.sent_command.head<6>().cast<double>().cwiseMax(-1.0).cwiseMin(1.0);
    left_ = goal - AchievedDelta(step.before, StateAfter(chunk, i), residual_).head<6>();
  }
}

Eigen::VectorXd LeakyGoal::correction() const {
  return (options_.memory * left_).cwiseMax(-options_.limit).cwiseMin(options_.limit);
}

bool LeakyGoal::Holds(const Eigen::VectorXd& state) const {
  return state.size() == 6 && (state.array().abs() <= kFarthest).all();
}

void LeakyGoal::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == 6);
  left_ = state;
}

}  // namespace robostress
