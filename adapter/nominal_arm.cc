#include "adapter/nominal_arm.h"

#include <cmath>

#include "adapter/panda_dynamics.h"

namespace robostress {

NominalArm::Vector6 NominalArm::Step(const Vector6& command, const RobotState& before) {
  const State old = state_;
  const Vector6 a = command.cwiseMax(-1.0).cwiseMin(1.0);
  Vector6 goal = options_.goal_reference == GoalReference::kAchieved ? a : Vector6(state_.goal + a);
  if (a.tail<3>().isZero(0)) goal.tail<3>() = state_.goal.tail<3>();

  const double h = options_.control_period_s / options_.sub_steps;
  const double kd = 2 * options_.damping_ratio * std::sqrt(options_.kp);
  const PandaDynamics arm =
      options_.panda_dynamics ? PandaDynamics::At(before.q, before.dq) : PandaDynamics();
  Vector6 x = Vector6::Zero();
  for (int i = 0; i < options_.sub_steps; ++i) {
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
