#pragma once

#include <Eigen/Core>
#include <array>

#include "common/joint_errors/sub_step.h"

namespace robostress {

using Vector7 = Eigen::Matrix<double, 7, 1>;

// Seven uncoupled joints of one inertia around a chain, on which nothing else acts.
struct FreeJoints {
  using Inverse = Eigen::Matrix<double, 7, 7, Eigen::RowMajor>;
  Vector7 dq = Vector7::Zero();             // [rad/s]
  Vector7 limit = Vector7::Constant(1e9);   // of the motors [Nm]
  double inertia = 1, rest = 0, h = 0.002;  // [kg m^2], [Nm], [s]
  Vector7 pulled = Vector7::Zero();         // by somebody else [Nm]

  Vector7 Limited(const Vector7& torque) const { return torque.cwiseMax(-limit).cwiseMin(limit); }
  Vector7 Net(const Vector7& torque) const { return torque + pulled; }
  Inverse MassMatrix() const { return inertia * Inverse::Identity(); }
  Vector7 Velocities() const { return dq; }
};

inline std::array<JointMoment, 7> MomentsOf(const Vector7& q, const Vector7& dq,
                                            const Vector7& gravity, double h = 0.002) {
  std::array<JointMoment, 7> moments;
  for (int j = 0; j < 7; ++j) {
    moments[j].h = h;
    moments[j].q = q[j];
    moments[j].dq = dq[j];
    moments[j].gravity = gravity[j];
  }
  return moments;
}

// At rest at q, held by `holding` [Nm].
inline void ResetAt(JointChain& chain, const Vector7& q, const Vector7& holding) {
  auto moments = MomentsOf(q, Vector7::Zero(), holding);
  for (int j = 0; j < 7; ++j) moments[j].drive = holding[j];
  chain.Reset(moments);
}

// What a controller's torques become at joints that are somewhere.
inline Vector7 TorqueOf(JointChain& chain, const Vector7& asked, const Vector7& gravity,
                        const FreeJoints& joints) {
  const Vector7 none = Vector7::Zero();
  auto moments = MomentsOf(none, joints.dq, gravity, joints.h);
  return SubStepTorque(chain, absl::MakeSpan(moments), asked, none, joints);
}

// Change of the offset that the paper's errors put into joints at q under `load`.
inline Vector7 MoveErrors(JointChain& chain, const Vector7& q, const Vector7& load,
                          double h = 0.002) {
  Vector7 change = Vector7::Zero();
  chain.MoveErrors({q.data(), 7}, {load.data(), 7}, h, {change.data(), 7});
  return change;
}

inline Vector7 OffsetOf(const JointChain& chain) {
  Vector7 offset;
  for (int j = 0; j < 7; ++j) offset[j] = chain.offset(j);
  return offset;
}

}  // namespace robostress
