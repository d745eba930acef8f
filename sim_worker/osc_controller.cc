#include "sim_worker/osc_controller.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>

#include "sim_worker/robosuite_rotation.h"

namespace robostress {
namespace {

// Solves A x = b for a symmetric positive semi-definite A; where A is singular to working
// precision, by the pseudo-inverse with numpy's cut-off (robosuite uses numpy.linalg.pinv).
template <int n>
Eigen::Matrix<double, n, 1> SolvePsd(const Eigen::Matrix<double, n, n>& A,
                                     const Eigen::Matrix<double, n, 1>& b) {
  const Eigen::LDLT<Eigen::Matrix<double, n, n>> ldlt(A);
  const auto pivots = ldlt.vectorD();
  if (pivots.minCoeff() > 1e-12 * pivots.maxCoeff()) return ldlt.solve(b);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, n, n>> eigen(A);
  const double cutoff = 1e-15 * eigen.eigenvalues().cwiseAbs().maxCoeff();
  Eigen::Matrix<double, n, 1> y = eigen.eigenvectors().transpose() * b;
  for (int i = 0; i < n; ++i)
    y[i] = std::abs(eigen.eigenvalues()[i]) > cutoff ? y[i] / eigen.eigenvalues()[i] : 0;
  return eigen.eigenvectors() * y;
}

}  // namespace

void OscController::Reset(const ArmState& arm, const Vector7d& q0) {
  p_goal_ = arm.p_tool;
  R_goal_ = arm.R_tool;
  q0_ = q0;
}

void OscController::SetGoal(const Eigen::Matrix<double, 6, 1>& command, const ArmState& arm) {
  const Eigen::Vector3d step = kPositionScale * command.head<3>();
  p_goal_ = (reference_ == GoalReference::kAchieved ? arm.p_tool : p_goal_) + step;
  const Eigen::Vector3d rotation = kRotationScale * command.tail<3>();
  const double angle = rotation.norm();
  if (angle == 0) return;
  const Eigen::Matrix3d& R_from = reference_ == GoalReference::kAchieved ? arm.R_tool : R_goal_;
  const Eigen::Vector3d axis = rotation / angle;
  if (single_precision_rotation_) {
    Eigen::Vector4d wxyz;
    wxyz << std::cos(angle / 2), axis * std::sin(angle / 2);
    R_goal_ = SinglePrecisionMatrix(wxyz) * R_from;
    return;
  }
  const Eigen::Matrix3d R_next = Eigen::AngleAxisd(angle, axis).toRotationMatrix() * R_from;
  // Re-orthonormalised, so that a goal that is carried from step to step stays a rotation.
  R_goal_ = Eigen::Quaterniond(R_next).normalized().toRotationMatrix();
}

Vector7d OscController::Torque(const ArmState& arm, const Vector7d& bias) const {
  static const double nullspace_kd = 2 * std::sqrt(kNullspaceKp);
  const double kd = 2 * std::sqrt(kp_);
  const Eigen::Matrix<double, 6, 1> twist = arm.J * arm.dq;
  Eigen::Vector3d e_rotation = Eigen::Vector3d::Zero();
  for (int i = 0; i < 3; ++i) e_rotation += 0.5 * arm.R_tool.col(i).cross(R_goal_.col(i));
  const Eigen::Vector3d force = kp_ * (p_goal_ - arm.p_tool) - kd * twist.head<3>();
  const Eigen::Vector3d torque = kp_ * e_rotation - kd * twist.tail<3>();

  // M^-1 through its Cholesky factor: J M^-1 J' = X' X with X = C^-1 J'.
  const Eigen::LLT<Matrix7d> cholesky(arm.M);
  const Eigen::Matrix<double, 7, 6> X = cholesky.matrixL().solve(arm.J.transpose());
  const Eigen::Matrix<double, 6, 6> A = X.transpose() * X;
  Eigen::Matrix<double, 6, 1> wrench;
  wrench.head<3>() = SolvePsd<3>(A.topLeftCorner<3, 3>(), force);
  wrench.tail<3>() = SolvePsd<3>(A.bottomRightCorner<3, 3>(), torque);

  const Vector7d posture = kNullspaceKp * (q0_ - arm.q) - nullspace_kd * arm.dq;
  const Eigen::Matrix<double, 6, 1> task_posture = arm.J * posture;
  wrench -= SolvePsd<6>(A, task_posture);
  return arm.J.transpose() * wrench + bias + arm.M * posture;
}

}  // namespace robostress
