#pragma once

#include <vector>

#include "common/rollout/robot.h"

namespace robostress {

// A point that follows 30 % (`follow`) of each commanded displacement. Succeeds once it has moved
// `goal` metres along x from its start. 7 joints that stand still, 7-D actions, proprioception (x,
// y).
class FakeRobot : public Robot {
 public:
  explicit FakeRobot(double goal = 1e9, int horizon = 7) : goal_(goal), horizon_(horizon) {}

  absl::Status Reset(int initial_state) override {
    ++resets;
    steps_ = 0;
    p_ = start_ = Eigen::Vector3d(0.01 * initial_state, 0.02, 0.3);
    return absl::OkStatus();
  }
  absl::StatusOr<Observation> Observe(const PolicySpec&) override {
    ++observations;
    Observation observation;
    observation.instruction = "move along x";
    observation.proprioception.resize(2);
    observation.proprioception[0] = static_cast<float>(p_.x());
    observation.proprioception[1] = static_cast<float>(p_.y());
    return observation;
  }
  absl::StatusOr<RobotState> Measure() override {
    RobotState state;
    state.stamp_s = 0.05 * steps_;
    state.q = state.dq = Eigen::VectorXd::Zero(7);
    state.tool.p_base_tool = p_;
    state.gripper = 0.04;
    return state;
  }
  absl::Status Step(const Eigen::VectorXf& command) override {
    if (steps_to_failure >= 0 && steps_to_failure-- == 0)
      return absl::InternalError("the arm tripped");
    commands.push_back(command);
    p_ += follow * 0.05 * command.head(3).cast<double>();
    ++steps_;
    return absl::OkStatus();
  }
  bool Success() const override { return p_.x() - start_.x() >= goal_; }
  int horizon() const override { return horizon_; }

  double follow = 0.3;
  int resets = 0, observations = 0;
  int steps_to_failure = -1;  // n >= 0: the n-th step from now fails
  std::vector<Eigen::VectorXf> commands;

 private:
  const double goal_;
  const int horizon_;
  int steps_ = 0;
  Eigen::Vector3d p_, start_;
};

}  // namespace robostress
