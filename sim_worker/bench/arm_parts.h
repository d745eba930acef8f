#pragma once

#include "common/check.h"
#include "common/joint_errors/joint_error_stack.h"
#include "sim_worker/osc_controller.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

// What a sub-step adds to MuJoCo's, each callable alone on the state of a simulator.
class ArmParts {
 public:
  // `sim` stands after a control step.
  explicit ArmParts(const PandaSim& sim)
      : sim_(sim),
        panda_(PandaModel::Find(sim.model()).value()),
        controller_(GoalReference::kAchieved) {
    Read();
    controller_.Reset(arm_, arm_.q);
  }

  void Read() { ReadArm(sim_.model(), sim_.data(), panda_, arm_); }
  Vector7d Torque() const { return controller_.Torque(arm_, arm_.q); }
  Vector7d Gravity() const { return GravityTorque(sim_.model(), sim_.data(), panda_); }

  // One sub-step of the scenario's joint errors at severity 5, without their gravity torque.
  JointErrorStack Errors(const std::string& scenario) const {
    constexpr int kHorizon = 220, kProgress = 10;  // [control steps]
    JointErrorStack errors{JointErrorOptions()};
    errors.SetScenario(MakeScenario(scenario, 5).value(), kHorizon);
    errors.Reset(arm_.q, Vector7d::Zero());
    errors.BeginControlStep(kProgress, false);
    return errors;
  }
  Vector7d OffsetChange(JointErrorStack& errors) const {
    const Vector7d torque = Vector7d::Constant(5), dq = Vector7d::Constant(0.05);
    errors.BeginSubStep(sim_.model().opt.timestep);
    const Vector7d load = errors.PerturbTorque(torque, dq, torque, panda_.torque_limit);
    return errors.OffsetChange(arm_.q, load);
  }

 private:
  const PandaSim& sim_;
  PandaModel panda_;
  OscController controller_;
  ArmState arm_;
};

}  // namespace robostress
