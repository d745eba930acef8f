#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "common/joint_errors/effects/joint_effect.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {

// The library's effects at the joints of a seven-joint arm under one scenario, by stage, beside the
// paper's errors (JointErrorStack). The arm's controller gives torques, so that a stage means:
//   command       the joint's torque command on its way to the motor (a rate limit is in Nm/s)
//   drive         the torque that the motor makes of it
//   torque        torques beside the motor's; dry friction is returned as limits, for StickTorques
//   transmission  the joint coordinate is the link's; the motor's is it minus offset()
//   sensor        the reading of a joint that the controller sees; outside the paper, which adds no
//                 noise to observations
// Per sub-step: Drive, Torques, OffsetChange. Holds no MuJoCo type. A copy has hidden states of its
// own.
class EffectStack {
 public:
  static constexpr int kJoints = 7;
  using Vector = Eigen::Matrix<double, kJoints, 1>;
  using Moments = std::array<JointMoment, kJoints>;

  EffectStack() = default;
  EffectStack(const EffectStack& other) { *this = other; }
  EffectStack& operator=(const EffectStack& other);

  // Types and numbers of values are those of the library (checked).
  void SetScenario(const Scenario& scenario);
  // At rest; `drive` of a moment is the torque that holds the joint. Transmissions that deflect
  // under it start deflected; q of a moment is the joint coordinate, which carries that already.
  void Reset(Moments moments);

  // Command and drive stage of the controller's torques [Nm]; fills `drive` of the moments.
  Vector Drive(const Vector& asked, Moments& moments);
  struct JointTorques {
    Vector torque = Vector::Zero();   // to be added [Nm]
    Vector inertia = Vector::Zero();  // that the joints gain [kg m^2]
    std::array<DryFriction, kJoints> dry;
  };
  JointTorques Torques(const Moments& moments);
  // Change of offset() over this sub-step [rad]; q of a moment is the motor's angle at its end.
  Vector OffsetChange(const Moments& moments);
  const Vector& offset() const { return offset_; }

  double Reading(int joint, double q_link) const;
  // d Reading / d q_link: readings are affine.
  double ReadingSlope(int joint) const { return Reading(joint, 1) - Reading(joint, 0); }

  bool any() const { return !effects_.empty(); }
  bool has(EffectStage stage) const { return has_[static_cast<int>(stage)]; }
  // Joint whose position `joint` is coupled to, or -1.
  int coupled(int joint) const { return coupled_[joint]; }

 private:
  struct Entry {
    int joint;
    EffectStage stage;
    std::unique_ptr<JointEffect> effect;
  };
  void SumOffsets(const Moments& moments);

  std::vector<Entry> effects_;  // in the order of the scenario
  std::array<bool, 5> has_{};
  std::array<int, kJoints> coupled_{};
  Vector offset_ = Vector::Zero();
};

}  // namespace robostress
