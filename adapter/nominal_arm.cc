#include "adapter/nominal_arm.h"

#include <cmath>

#include "adapter/panda_coupling.h"

namespace robostress {

NominalArm::Vector6 NominalArm::Step(const Vector6& command, const Eigen::VectorXd& q) {
  const State before = state_;
  const Vector6 a = command.cwiseMax(-1.0).cwiseMin(1.0);
  Vector6 goal = options_.goal_reference == GoalReference::kAchieved ? a : Vector6(state_.goal + a);
  if (a.tail<3>().isZero(0)) goal.tail<3>() = state_.goal.tail<3>();

  const double h = options_.control_period_s / options_.sub_steps;
  const double kd = 2 * options_.damping_ratio * std::sqrt(options_.kp);
  Eigen::Matrix<double, 6, 6> coupling = Eigen::Matrix<double, 6, 6>::Identity();
  if (options_.panda_coupling) coupling = PandaCoupling(q);
  Vector6 x = Vector6::Zero();
  for (int i = 0; i < options_.sub_steps; ++i) {
    Vector6 acceleration = options_.kp * (goal - x) - kd * state_.velocity;
    if (options_.panda_coupling) acceleration = coupling * acceleration;
    state_.velocity += h * acceleration;
    x += h * state_.velocity;
  }
  state_.goal = goal - x;
  if (Holds(state_)) return x;
  state_ = before;
  return Vector6::Zero();
}

bool NominalArm::Holds(const State& state) {
  // Written so that what is not a number does not hold.
  return (state.goal.array().abs() <= kMaxState).all() &&
         (state.velocity.array().abs() <= kMaxState).all();
}

}  // namespace robostress
