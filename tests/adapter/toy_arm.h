#pragma once

#include "common/so3.h"
#include "common/types.h"

namespace robostress {

// An arm that moves by `gain` times what it is told, in one step and without lag.
class ToyArm {
 public:
  explicit ToyArm(double gain) : gain_(gain) {
    state_.q = Eigen::VectorXd::Zero(7);
    state_.dq = Eigen::VectorXd::Zero(7);
    state_.gripper = 0.08;
  }

  const RobotState& state() const { return state_; }

  void Step(const Eigen::VectorXf& command) {
    const Eigen::VectorXd a = command.cast<double>().cwiseMax(-1.0).cwiseMin(1.0);
    state_.tool.p_base_tool += gain_ * 0.05 * a.head<3>();
    state_.tool.q_base_tool =
        (ExpSo3(gain_ * 0.5 * a.segment<3>(3)) * state_.tool.q_base_tool).normalized();
    state_.stamp_s += 0.05;
  }

  // Executes rows first .. first + steps - 1 of a prediction.
  ExecutedChunk Execute(const PredictedChunk& prediction, int steps, int first = 0) {
    ExecutedChunk chunk;
    chunk.prediction_id = prediction.prediction_id;
    chunk.first_step = first;
    for (int i = first; i < first + steps; ++i) {
      ExecutedStep step;
      step.before = state_;
      step.policy_command = prediction.policy_actions.row(i);
      if (prediction.base_actions.rows() > 0) step.base_command = prediction.base_actions.row(i);
      step.sent_command = prediction.actions.row(i);
      Step(step.sent_command);
      chunk.steps.push_back(step);
    }
    chunk.final_state = state_;
    return chunk;
  }

 private:
  double gain_;
  RobotState state_;
};

// A prediction whose rows are all `action`.
inline PredictedChunk ConstantPrediction(const Eigen::VectorXf& action, int rows) {
  PredictedChunk prediction;
  prediction.prediction_id = 1;
  prediction.actions = action.transpose().replicate(rows, 1);
  prediction.policy_actions = prediction.actions;
  prediction.base_actions = prediction.actions;
  return prediction;
}

}  // namespace robostress
