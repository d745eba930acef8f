#include "common/joint_errors/joint_error_stack.h"

#include <algorithm>

#include "common/check.h"
#include "common/joint_errors/friction.h"
#include "common/joint_errors/gravity_residual.h"
#include "common/joint_errors/severity.h"

namespace robostress {

JointErrorStack::JointErrorStack(const JointErrorOptions& options) : options_(options) {
  scenario_.name = "clean";
  Rescale(0, 0);
}

void JointErrorStack::SetScenario(const Scenario& scenario, int horizon) {
  RS_CHECK(!scenario.start.empty() || !(scenario.friction_on || scenario.gravity_on ||
                                        scenario.backlash_on || scenario.compliance_on));
  RS_CHECK(horizon >= 1);
  scenario_ = scenario;
  horizon_ = horizon;
}

void JointErrorStack::Reset(const Vector& q, const Vector& holding_torque) {
  gate_.Reset();
  progress_ = 0;
  Rescale(0, 0);
  offset_.setZero();
  for (int j = 0; j < kJoints; ++j) {
    if (scenario_.compliance_on && options_.offset_start == OffsetStart::kEquilibrium) {
      offset_[j] = Compliance::Equilibrium(parameters_[j], holding_torque[j]);
    }
    compliance_[j].Reset(offset_[j]);
    backlash_[j].Reset(q[j] - offset_[j]);
  }
}

void JointErrorStack::BeginControlStep(int steps_done, bool held) {
  gate_.BeginControlStep(held);
  progress_ = std::min(static_cast<double>(steps_done) / horizon_, 1.0);
}

void JointErrorStack::BeginSubStep(double h) {
  h_ = h;
  const double grasp = gate_.SubStep(h);
  if (scenario_.profile != SeverityProfile::kFixed) Rescale(progress_, grasp);
}

void JointErrorStack::Rescale(double progress, double grasp) {
  const std::vector<JointErrorParameters>& nominal = NominalPandaErrors();
  for (int j = 0; j < kJoints; ++j) {
    factors_[j] =
        scenario_.start.empty() ? SeverityFactors() : FactorOfJoint(scenario_, j, progress, grasp);
    parameters_[j] = Scale(nominal[j], factors_[j]);
  }
}

JointErrorStack::Vector JointErrorStack::TorqueWithoutDryFriction(const Vector& controller,
                                                                  const Vector& dq,
                                                                  const Vector& gravity) const {
  Vector torque = controller;
  for (int j = 0; j < kJoints; ++j) {
    if (scenario_.friction_on) torque[j] -= parameters_[j].sigma_v * dq[j];
    if (scenario_.gravity_on)
      torque[j] += GravityResidual(parameters_[j], gravity[j], options_.gravity_sign);
  }
  return torque;
}

JointErrorStack::Vector JointErrorStack::AddStickFriction(const Vector& torque, const Vector& dq,
                                                          const Vector& v_free,
                                                          const Matrix& velocity_per_torque,
                                                          const Vector& limit) const {
  Vector magnitude, friction;
  for (int j = 0; j < kJoints; ++j) magnitude[j] = StribeckMagnitude(parameters_[j], dq[j]);
  StickTorques({v_free.data(), kJoints}, {velocity_per_torque.data(), kJoints * kJoints},
               {magnitude.data(), kJoints}, {friction.data(), kJoints});
  return (torque + friction).cwiseMax(-limit).cwiseMin(limit);
}

JointErrorStack::Vector JointErrorStack::PerturbTorque(const Vector& controller, const Vector& dq,
                                                       const Vector& gravity,
                                                       const Vector& limit) const {
  Vector torque = controller;
  for (int j = 0; j < kJoints; ++j) {
    if (scenario_.friction_on) {
      torque[j] +=
          StribeckTorque(parameters_[j], dq[j], options_.friction_law, options_.tanh_width);
    }
    if (scenario_.gravity_on)
      torque[j] += GravityResidual(parameters_[j], gravity[j], options_.gravity_sign);
  }
  return torque.cwiseMax(-limit).cwiseMin(limit);
}

JointErrorStack::Vector JointErrorStack::OffsetChange(const Vector& q_joint,
                                                      const Vector& tau_load) {
  Vector next = Vector::Zero();
  for (int j = 0; j < kJoints; ++j) {
    const double q_motor = q_joint[j] - offset_[j];
    if (scenario_.backlash_on) next[j] += backlash_[j].Step(parameters_[j], q_motor);
    if (scenario_.compliance_on) next[j] += compliance_[j].Step(parameters_[j], tau_load[j], h_);
  }
  const Vector change = next - offset_;
  offset_ = next;
  return change;
}

}  // namespace robostress
