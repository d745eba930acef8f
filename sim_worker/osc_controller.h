#pragma once

#include <Eigen/Core>

#include "common/unit_config.h"
#include "sim_worker/panda_model.h"

namespace robostress {

// Operational-space control of position and orientation, robosuite 1.4.0's OSC_POSE with its
// defaults:
//   F = kp (p_goal - p) - kd v          e_R = 1/2 sum_i R_i x R_goal,i
//   T = kp e_R - kd w
//   tau = J' [Lp F; Lr T] + bias + N' M (k0 (q0 - q) - d0 dq)
// with Lp = (Jp M^-1 Jp')^-1, Lr = (Jr M^-1 Jr')^-1, L = (J M^-1 J')^-1 and N = I - M^-1 J' L J, so
// that N' M u = M u - J' L J u. kd = 2 sqrt(kp), d0 = 2 sqrt(k0) (damping ratio 1).
class OscController {
 public:
  static constexpr double kPositionScale = 0.05;  // [m] per unit of command
  static constexpr double kRotationScale = 0.5;   // [rad] per unit of command
  static constexpr double kNullspaceKp = 10;      // [1/s^2]

  // single_precision_rotation: a command's rotation becomes a matrix by robosuite's quat2mat, in
  // single precision. kp [1/s^2].
  explicit OscController(GoalReference reference, bool single_precision_rotation = false,
                         double kp = kControllerKp)
      : reference_(reference), single_precision_rotation_(single_precision_rotation), kp_(kp) {}

  // Goal at the pose of `arm`; q0: null-space posture.
  void Reset(const ArmState& arm, const Vector7d& q0);
  // Moves the goal once per control step by the normalised delta command[0..5] in +-1, translation
  // and world-frame axis-angle. Achieved: from the pose in `arm`, and the orientation goal stays
  // where it is unless the command rotates (robosuite). Desired: from the previous goal.
  void SetGoal(const Eigen::Matrix<double, 6, 1>& command, const ArmState& arm);
  // Not saturated [Nm]. bias: Coriolis, centrifugal and gravity torque.
  Vector7d Torque(const ArmState& arm, const Vector7d& bias) const;

  const Eigen::Vector3d& goal_position() const { return p_goal_; }  // world frame [m]
  const Eigen::Matrix3d& goal_rotation() const { return R_goal_; }  // of the site, world frame

 private:
  GoalReference reference_;
  bool single_precision_rotation_;
  double kp_;
  Eigen::Vector3d p_goal_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d R_goal_ = Eigen::Matrix3d::Identity();
  Vector7d q0_ = Vector7d::Zero();
};

}  // namespace robostress
