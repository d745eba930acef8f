#pragma once

#include "adapter/nominal_arm.h"
#include "common/so3.h"
#include "common/types.h"

namespace robostress {

// A nominal arm whose commands are scaled by `gain` and shifted by `disturbance` on their way.
class DisturbedArm {
 public:
  // `joints`: positions and velocities, which stay.
  DisturbedArm(double gain, const NominalArm::Vector6& disturbance,
               const NominalArmOptions& nominal = {}, const RobotState& joints = {})
      : gain_(gain), disturbance_(disturbance), arm_(nominal), state_(joints) {}

  // Executes `command` minus `correction` for `steps` control steps, as one chunk.
  ExecutedChunk Execute(const NominalArm::Vector6& command, const NominalArm::Vector6& correction,
                        int steps = 5) {
    ExecutedChunk chunk;
    for (int i = 0; i < steps; ++i) {
      ExecutedStep step;
      step.before = state_;
      step.policy_command = Eigen::VectorXf::Zero(7);
      step.policy_command.head<6>() = command.cast<float>();
      step.sent_command = step.policy_command;
      step.sent_command.head<6>() = (command - correction).cast<float>();
      Move(step.sent_command.head<6>().cast<double>());
      chunk.steps.push_back(step);
    }
    chunk.final_state = state_;
    return chunk;
  }
  void set_disturbance(const NominalArm::Vector6& disturbance) { disturbance_ = disturbance; }
  const NominalArm::Vector6& last_motion() const { return motion_; }  // normalised

 private:
  void Move(const NominalArm::Vector6& command) {
    motion_ = arm_.Step(gain_ * command + disturbance_, state_);
    state_.tool.p_base_tool += 0.05 * motion_.head<3>();
    state_.tool.q_base_tool =
        (ExpSo3(0.5 * motion_.tail<3>()) * state_.tool.q_base_tool).normalized();
  }

  double gain_;
  NominalArm::Vector6 disturbance_, motion_ = NominalArm::Vector6::Zero();
  NominalArm arm_;
  RobotState state_;
};

}  // namespace robostress
