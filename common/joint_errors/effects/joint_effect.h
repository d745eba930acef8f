#pragma once

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "absl/types/span.h"

namespace robostress {

// Where an effect acts on the way from a command to a reading.
enum class EffectStage {
  kCommand,       // what the servo, the motor or the second channel is given
  kDrive,         // the motor's torque
  kJoint,         // torques on the joint beside the motor's
  kTransmission,  // from the motor's angle to the link's
  kSensor,        // from the link's angle to its reading; outside the paper, which adds no noise
};

// What an effect sees of its joint in one sub-step. Units of a slide: m, N, kg instead of rad, Nm,
// kg m^2.
struct JointMoment {
  double t = 0;                     // [s] since the log began
  double h = 0;                     // [s] length of the sub-step
  double q = 0;                     // [rad] motor side
  double dq = 0;                    // [rad/s]
  double drive = 0;                 // [Nm] torque of the motor
  double gravity = 0;               // [Nm] torque that holds the joint against gravity
  double payload_gravity = 0;       // [Nm/kg] the same of 1 kg at the payload's place
  double payload_inertia = 0;       // [kg m^2/kg]
  double tilt_gravity[2] = {0, 0};  // [Nm/rad] change of `gravity` as the base tilts about x, y
  // Of the joint that this one is coupled to [rad, rad/s, rad/s^2].
  double coupled_q = 0, coupled_dq = 0, coupled_ddq = 0;
  // [deg C] of the joint; NaN: nobody measures it.
  double temperature = std::numeric_limits<double>::quiet_NaN();
};

// Fields of a moment that cost something to fill, as bits; and the motor's torque, which is what
// is sought where a motion is given.
enum MomentField : unsigned {
  kGravityField = 1,
  kPayloadFields = 2,
  kTiltField = 4,
  kDriveField = 8
};

// The largest torques [Nm] with which dry friction resists motion forwards (dq > 0) and backwards.
// Sums may be negative; the simulation clips them at zero.
struct DryFriction {
  double forward = 0, backward = 0;
};

// One effect at one joint, with its hidden state. Only the function of its stage is overridden.
// A function is called once per sub-step, in the order of time.
class JointEffect {
 public:
  virtual ~JointEffect() = default;

  // `values` in the order of EffectInfo::parameters. Does not touch the state.
  virtual void SetParameters(absl::Span<const double> values) = 0;
  // State of a joint at rest at this moment.
  virtual void Reset(const JointMoment&) {}
  // Whether what it does depends on what happened before.
  virtual bool HasState() const { return false; }
  // Which MomentFields it reads.
  virtual unsigned Reads() const { return 0; }

  // kCommand: the command that arrives; `command` is the one given over this sub-step.
  virtual double Command(double command, const JointMoment&) { return command; }
  // kCommand: whether what arrives changes over a sub-step, so that Command is where it ends.
  virtual bool CommandSlides() const { return false; }
  // Follows the command itself, up to a limit: asks for where the command is at the step's end, and
  // not for its mean.
  virtual bool CommandLimits() const { return false; }
  // kDrive: the motor's torque [Nm] for the torque asked of it.
  virtual double Drive(double torque, const JointMoment&) { return torque; }
  // kDrive: its inverse, the torque asked of the motor [Nm] where the motor makes `torque`. `asked`
  // is what was asked as far as it is known: it says no more than whether a limit was reached.
  virtual double Asked(double torque, double asked, const JointMoment&) {
    (void)asked;
    return torque;
  }
  // kJoint: a torque [Nm] that is added, and what it adds to dry friction.
  virtual double Torque(const JointMoment&, DryFriction&) { return 0; }
  // kJoint: what it adds to the inertia [kg m^2].
  virtual double Inertia(const JointMoment&) { return 0; }
  // kTransmission: link angle minus motor angle [rad].
  virtual double Offset(const JointMoment&) { return 0; }
  // kSensor: the reading of a link angle [rad].
  virtual double Reading(double q_link) { return q_link; }
  // Its derivative by q_link.
  virtual double ReadingSlope(double q_link) {
    (void)q_link;
    return 1;
  }
  // With parameters and hidden state, for snapshots of a simulation.
  virtual std::unique_ptr<JointEffect> Clone() const = 0;
};

// Gives an effect its Clone.
template <class Effect>
class CopyableEffect : public JointEffect {
 public:
  std::unique_ptr<JointEffect> Clone() const override {
    return std::make_unique<Effect>(static_cast<const Effect&>(*this));
  }
};

}  // namespace robostress
