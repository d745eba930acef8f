#pragma once

#include <array>

#include "common/check.h"
#include "common/joint_errors/sub_step.h"
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
  JointChain Errors(const std::string& scenario) const {
    constexpr int kHorizon = 220, kProgress = 10;  // [control steps]
    JointChain errors(7);
    errors.SetScenario(MakeScenario(scenario, 5).value(), kHorizon);
    std::array<JointMoment, 7> moments;
    for (int i = 0; i < 7; ++i) moments[i].q = arm_.q[i];
    errors.Reset(moments);
    errors.BeginControlStep(kProgress, false);
    return errors;
  }
  Vector7d OffsetChange(JointChain& errors) const {
    const double h = sim_.model().opt.timestep;
    std::array<JointMoment, 7> moments;
    for (JointMoment& moment : moments) {
      moment.h = h;
      moment.dq = 0.05;
      moment.gravity = 5;
    }
    errors.BeginSubStep(h);
    const Vector7d torque = Vector7d::Constant(5), none = Vector7d::Zero();
    const Vector7d load =
        SubStepTorque(errors, absl::MakeSpan(moments), torque, none, Limits{panda_.torque_limit});
    Vector7d change = none;
    errors.MoveErrors({arm_.q.data(), 7}, {load.data(), 7}, h, {change.data(), 7});
    return change;
  }

 private:
  // Joints that nothing sticks to.
  struct Limits {
    using Inverse = Matrix7d;
    const Vector7d& limit;
    double rest = 0, h = 0;
    Vector7d Limited(const Vector7d& torque) const {
      return torque.cwiseMax(-limit).cwiseMin(limit);
    }
    Vector7d Net(const Vector7d& torque) const { return torque; }
    Matrix7d MassMatrix() const { return Matrix7d::Identity(); }
    Vector7d Velocities() const { return Vector7d::Zero(); }
  };

  const PandaSim& sim_;
  PandaModel panda_;
  OscController controller_;
  ArmState arm_;
};

}  // namespace robostress
