#pragma once

#include <Eigen/Core>
#include <array>

#include "common/joint_errors/backlash.h"
#include "common/joint_errors/compliance.h"
#include "common/joint_errors/grasp_gate.h"
#include "common/joint_errors/options.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {

// The four joint errors of a seven-joint arm under one scenario, in the order of the paper
// (sec:supp_injection). Per physics sub-step:
//   BeginSubStep(h)                       severity factors of this moment
//   tau_load = PerturbTorque(...)         friction and gravity residual added, the sum saturated
//   change   = OffsetChange(q, tau_load)  backlash from the motor angle, compliance from tau_load
// and `change` is added to the joint coordinates before the integration. Compliance is driven by
// tau_load after saturation: that is what "is applied to the actuator" (paper, sec:hybrid), so a
// deflection never exceeds the motor's limit over the stiffness in steady state. Holds no MuJoCo
// type; allocates only in SetScenario.
class JointErrorStack {
 public:
  static constexpr int kJoints = 7;
  using Vector = Eigen::Matrix<double, kJoints, 1>;
  using Matrix = Eigen::Matrix<double, kJoints, kJoints, Eigen::RowMajor>;

  explicit JointErrorStack(const JointErrorOptions& options);

  // From the next Reset on. horizon [control steps]: over which a ramp runs.
  void SetScenario(const Scenario& scenario, int horizon);
  // Hidden states start anew: link at the motor, gate open, progress 0, deflection zero or, under
  // offset_start: equilibrium, static under holding_torque. q [rad] is the joint coordinate, and is
  // taken to carry that deflection already.
  void Reset(const Vector& q, const Vector& holding_torque);

  // steps_done: control steps of the episode before this one (0 while settling); held: the grasp
  // check.
  void BeginControlStep(int steps_done, bool held);
  void BeginSubStep(double h);

  // Torque stage. dq [rad/s]; gravity [Nm]: torque at zero velocity; limit [Nm]: of the motors.
  Vector PerturbTorque(const Vector& controller, const Vector& dq, const Vector& gravity,
                       const Vector& limit) const;
  // The same under friction_law: stick, which needs the sub-step's free velocity: v_free [rad/s] is
  // the one after the sub-step under `controller` and the residuals without dry friction, and
  // velocity_per_torque is h M^-1. limit saturates the sum, dry friction included.
  Vector TorqueWithoutDryFriction(const Vector& controller, const Vector& dq,
                                  const Vector& gravity) const;
  Vector AddStickFriction(const Vector& torque, const Vector& dq, const Vector& v_free,
                          const Matrix& velocity_per_torque, const Vector& limit) const;
  // Position stage: change of the offset since the previous sub-step [rad].
  Vector OffsetChange(const Vector& q_joint, const Vector& tau_load);

  // The offset that the joint coordinates carry now [rad].
  const Vector& offset() const { return offset_; }
  // The two parts of offset()[joint] [rad].
  double compliance_deflection(int joint) const { return compliance_[joint].deflection(); }
  double backlash_offset(int joint) const { return offset_[joint] - compliance_deflection(joint); }
  const std::array<JointErrorParameters, kJoints>& parameters() const { return parameters_; }
  const std::array<SeverityFactors, kJoints>& factors() const { return factors_; }
  const Scenario& scenario() const { return scenario_; }
  bool any() const { return torque_stage() || position_stage(); }
  bool torque_stage() const { return scenario_.friction_on || scenario_.gravity_on; }
  bool position_stage() const { return scenario_.backlash_on || scenario_.compliance_on; }
  bool gate_closed() const { return gate_.closed(); }

 private:
  void Rescale(double progress, double grasp);

  JointErrorOptions options_;
  Scenario scenario_;  // default: Clean, every component off
  int horizon_ = 1;
  double h_ = 0;  // [s]
  double progress_ = 0;
  GraspGate gate_;
  std::array<SeverityFactors, kJoints> factors_;
  std::array<JointErrorParameters, kJoints> parameters_;
  std::array<Backlash, kJoints> backlash_;
  std::array<Compliance, kJoints> compliance_;
  Vector offset_ = Vector::Zero();
};

}  // namespace robostress
