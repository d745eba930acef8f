#include "adapter/nominal_arm.h"

#include <algorithm>
#include <cmath>

#include "adapter/panda_dynamics.h"

namespace robostress {

NominalArm::Vector6 NominalArm::Step(const Vector6& command, const RobotState& before) {
  const State old = state_;
  const Vector6 a = command.cwiseMax(-1.0).cwiseMin(1.0);
  Vector6 goal = options_.goal_reference == GoalReference::kAchieved ? a : Vector6(state_.goal + a);
  if (a.tail<3>().isZero(0)) goal.tail<3>() = state_.goal.tail<3>();

  int sub_steps = options_.sub_steps;
  PandaDynamics arm;
  if (options_.panda_dynamics) {
    // Twice as stiff along the coupling's eigenvectors: steps of 20 ms stay stable.
    sub_steps = std::max(sub_steps, static_cast<int>(std::ceil(options_.control_period_s / 0.02)));
    Vector6 scale;
    scale << Eigen::Vector3d::Constant(options_.translation_scale),
        Eigen::Vector3d::Constant(options_.rotation_scale);
    arm = PandaDynamics::At(before.q, before.dq);
    arm.coupling = scale.cwiseInverse().asDiagonal() * arm.coupling * scale.asDiagonal();
    arm.drift = arm.drift.cwiseQuotient(scale);
  }
  const double h = options_.control_period_s / sub_steps;
  const double kd = 2 * options_.damping_ratio * std::sqrt(options_.kp);
  Vector6 x = Vector6::Zero();
  for (int i = 0; i < sub_steps; ++i) {
    const Vector6 force = options_.kp * (goal - x) - kd * state_.velocity;
    state_.velocity += h * (arm.coupling * force + arm.drift);
    x += h * state_.velocity;
  }
  state_.goal = goal - x;
  if (Holds(state_)) return x;
  state_ = old;
  return Vector6::Zero();
}

bool NominalArm::Holds(const State& state) {
  // Written so that what is not a number does not hold.
  return (state.goal.array().abs() <= kMaxState).all() &&
         (state.velocity.array().abs() <= kMaxState).all();
}

}  // namespace robostress
