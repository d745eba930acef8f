#pragma once

#include <array>
#include <memory>
#include <vector>

#include "absl/types/span.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/joint_errors/paper_errors.h"
#include "common/joint_errors/severity.h"

namespace robostress {

// What a scenario does to the joints of an arm, from the command to the reading: the paper's four
// errors and the effects of a scenario file, all of them effects of the library. For any number of
// joints and without a simulator; sub_step.h says in which order the stages act:
//   command       the joint's torque command on its way to the motor
//   drive         the torque that the motor makes of it
//   torque        torques beside the motor's; dry friction is returned as limits (stick_friction.h)
//   transmission  the joint coordinate is the link's; the motor's is it minus offset()
//   sensor        the reading of a joint that the controller sees
// The paper's errors (sec:supp_injection) lie between the motor and the effects. They follow the
// severity of the moment, and their deflection answers the torque that the joint got, saturated:
// that is what "is applied to the actuator" (paper, sec:hybrid).
// Spans and vectors have an entry per joint. Allocates in SetScenario, Add, Reset and copies alone.
// A copy has hidden states of its own.
class JointChain {
 public:
  struct Link {
    Link(int joint, std::unique_ptr<JointEffect> effect, int error)
        : joint(joint), error(error), effect(std::move(effect)) {}
    Link(const Link& other)
        : joint(other.joint),
          error(other.error),
          factor(other.factor),
          offset(other.offset),
          effect(other.effect->Clone()) {}
    Link(Link&&) = default;
    Link& operator=(const Link& other) { return *this = Link(other); }
    Link& operator=(Link&&) = default;

    int joint;
    int error;           // PaperErrorKind; -1: an effect
    double factor = -1;  // error: of its parameters
    double offset = 0;   // transmission: at the last sub-step [rad]
    std::unique_ptr<JointEffect> effect;
  };

  explicit JointChain(int joints, const JointErrorOptions& options = {});
  int joints() const { return static_cast<int>(coupled_.size()); }

  // From the next Reset on. Effects are the library's, at joints of the arm (checked).
  void SetScenario(const Scenario& scenario, int horizon);
  // One more effect, behind those of its stage. coupled: of cross_joint_coupling.
  void Add(int joint, const EffectInfo& info, absl::Span<const double> values, int coupled = -1);

  // An episode begins at rest: q is the joint coordinate, which carries its offset already, drive
  // the torque that holds the joint. The link stands at the motor, in the middle of gaps; springs
  // of effects, and under offset_start: equilibrium the paper's, are deflected by that torque.
  void Reset(absl::Span<const JointMoment> joints);
  void BeginControlStep(int steps_done, bool held) { severity_.BeginControlStep(steps_done, held); }
  void BeginSubStep(double h);

  // Command and drive stage of the torques that a controller asks for [Nm]; fills `drive`.
  void Drive(absl::Span<JointMoment> moments, absl::Span<double> torque);
  // Torque stage, added to `torque` [Nm]; the rest of it is dry() and inertia() until the next one.
  void AddTorques(absl::Span<const JointMoment> moments, absl::Span<double> torque);
  absl::Span<const DryFriction> dry() const { return dry_; }
  absl::Span<const double> inertia() const { return inertia_; }  // that joints gain [kg m^2]
  // Whether dry friction or inertia make the joints' torques one problem.
  bool sticks() const { return sticks_; }

  // Transmission stage over a sub-step of h [s]; adds to `change` what becomes of offset() [rad].
  // The paper's errors see the joint coordinates q at its start and the torques on the joints.
  void MoveErrors(absl::Span<const double> q, absl::Span<const double> load, double h,
                  absl::Span<double> change);
  // Effects see `drive`, and as q of a moment the motor's angle at the sub-step's end.
  void MoveEffects(absl::Span<const JointMoment> moments, absl::Span<double> change);
  // Link angle minus motor angle now [rad].
  double offset(int joint) const { return errors_.offset[joint] + effects_.offset[joint]; }
  double MotorAngle(int joint, double q) const {
    return q - errors_.offset[joint] - effects_.offset[joint];
  }
  // What one of the paper's errors has in it [rad].
  double error_offset(PaperErrorKind kind, int joint) const;

  double Reading(int joint, double q_link) const;
  // d Reading / d q_link at q_link.
  double ReadingSlope(int joint, double q_link) const;

  // Whether anything acts at a stage; whether there is any effect beside the paper's errors.
  bool has(EffectStage stage) const { return has_errors(stage) || has_effects(stage); }
  bool any_effects() const;
  // The effects of a stage, in the order in which they act.
  absl::Span<const Link> effects(EffectStage stage) const { return effects_.of(stage); }
  unsigned reads() const { return reads_; }  // MomentFields
  // Joint whose motion `joint` is coupled to, or -1.
  int coupled(int joint) const { return coupled_[joint]; }
  const SeverityCourse& severity() const { return severity_; }

 private:
  bool has_errors(EffectStage stage) const { return !errors_.of(stage).empty(); }
  bool has_effects(EffectStage stage) const { return !effects_.of(stage).empty(); }
  // Everything of one origin, by stage.
  struct Part {
    std::array<std::vector<Link>, 5> stages;
    std::vector<double> offset;  // of its transmissions [rad]
    std::vector<Link>& of(EffectStage stage) { return stages[static_cast<int>(stage)]; }
    const std::vector<Link>& of(EffectStage stage) const { return stages[static_cast<int>(stage)]; }
  };
  void Place(Part& part, EffectStage stage, Link link);
  void Reset(Part& part, std::vector<JointMoment> moments) const;
  void SetErrorParameters();

  JointErrorOptions options_;
  SeverityCourse severity_;
  Part errors_, effects_;
  std::vector<int> coupled_;
  unsigned reads_ = 0;
  bool sticks_ = false;
  std::vector<double> sum_, inertia_;
  std::vector<DryFriction> dry_;
  std::vector<JointMoment> at_errors_;
};

}  // namespace robostress
