#include "robot_client/teach/jog_target.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

constexpr double kTurnLength = 0.1;  // [m/rad], weighs turns against ways
constexpr double kNear = 0.012;      // singular value [m] below which a direction is damped ...
constexpr double kMost = 0.02;       // ... by this much in the singularity
constexpr double kLead = 0.1;        // [rad] at most between the target and the command

double Damped(double s) {
  const double share = s / kNear;
  const double square = share < 1 ? kMost * kMost * (1 - share * share) : 0;
  return s / (s * s + square);
}

}  // namespace

JogTarget::Vector6 JogTarget::JointVelocity(const JogInput& input) const {
  Vector6 wanted;
  for (int i = 0; i < 3; ++i) {
    wanted[i] = options_.tool_velocity * input.tool[i];
    wanted[3 + i] = kTurnLength * options_.turn_velocity * input.tool[3 + i];
  }
  if (wanted.isZero()) return Vector6::Zero();
  Eigen::Matrix<double, 6, piper::kJoints> J = jacobian_(target_);
  J.bottomRows<3>() *= kTurnLength;
  Vector6 dq = Vector6::Zero();
  for (int round = 0; round < piper::kJoints; ++round) {
    const Eigen::JacobiSVD<Eigen::Matrix<double, 6, piper::kJoints>> svd(
        J, Eigen::ComputeFullU | Eigen::ComputeFullV);
    dq.setZero();
    for (int i = 0; i < piper::kJoints; ++i) {
      dq +=
          Damped(svd.singularValues()[i]) * svd.matrixU().col(i).dot(wanted) * svd.matrixV().col(i);
    }
    int blocked = -1;
    for (int j = 0; j < piper::kJoints; ++j) {
      const double next = target_[j] + dq[j] * options_.period_s;
      const bool out = (dq[j] < 0 && next < limits_.lower[j] + options_.joint_margin) ||
                       (dq[j] > 0 && next > limits_.upper[j] - options_.joint_margin);
      if (out && !J.col(j).isZero()) blocked = j;
      if (out) dq[j] = 0;
    }
    if (blocked < 0) break;
    J.col(blocked).setZero();
  }
  const double fastest = dq.cwiseAbs().maxCoeff();
  return fastest > options_.fastest_joint ? Vector6(dq * (options_.fastest_joint / fastest)) : dq;
}

LiveRow JogTarget::Next(int64_t now_ns, const ArmVector& command) {
  const JogInput input = input_->Load();
  const double age = static_cast<double>(now_ns - input.stamp_ns) * 1e-9;
  if (!input.gone && age <= options_.dead_man_s) {
    Vector6 dq = Vector6::Zero();
    if (input.by_joint) {
      dq[std::clamp(input.joint, 0, piper::kJoints - 1)] = options_.joint_velocity * input.tool[0];
    } else {
      dq = JointVelocity(input);
    }
    for (int j = 0; j < piper::kJoints; ++j) target_[j] += dq[j] * options_.period_s;
    target_[piper::kJoints] += options_.gripper_velocity * input.gripper * options_.period_s;
  }
  // Where the command is kept back, by the workspace for one, the target waits for it.
  for (int i = 0; i < piper::kAxes; ++i) {
    const double margin = i < piper::kJoints ? options_.joint_margin : 0;
    const double lead = i < piper::kJoints ? kLead : 0.02;
    const double lower = std::min(limits_.lower[i] + margin, command[i]);
    const double upper = std::max(limits_.upper[i] - margin, command[i]);
    target_[i] = std::clamp(target_[i], std::max(lower, command[i] - lead),
                            std::min(upper, command[i] + lead));
  }
  return {target_, target_, false};
}

}  // namespace robostress
