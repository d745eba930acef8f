#pragma once

#include <cstdint>

#include "robot_client/robot_arm.h"

namespace robostress {

// Bounds of what is sent, per axis: joints [rad], gripper [m].
struct LimiterOptions {
  double joint_velocity = 1.0;      // [rad/s]
  double joint_acceleration = 5.0;  // [rad/s^2]
  double joint_jerk = 50;           // [rad/s^3]; infinite: not limited
  double joint_step = 0.05;         // [rad], most between two commands
  double joint_margin = 0.02;       // [rad], kept from the arm's position limits
  double gripper_velocity = 0.2;    // [m/s]
  double gripper_acceleration = 4;  // [m/s^2]
  double gripper_step = 0.01;       // [m]

  template <class V>
  void Visit(V& v) {
    v.Field("joint_velocity", joint_velocity, "most speed of a joint's command [rad/s]");
    v.Field("joint_acceleration", joint_acceleration, "[rad/s^2]");
    v.Field("joint_jerk", joint_jerk, "[rad/s^3]; .inf: not limited");
    v.Field("joint_step", joint_step, "most change between two commands [rad]");
    v.Field("joint_margin", joint_margin, "distance kept from the arm's position limits [rad]");
    v.Field("gripper_velocity", gripper_velocity, "[m/s]");
    v.Field("gripper_acceleration", gripper_acceleration, "[m/s^2]");
    v.Field("gripper_step", gripper_step, "most change between two commands [m]");
  }
};

// What held a command back, one bit per kind (any axis).
enum LimiterFlag : uint8_t {
  kLimitedPosition = 1,
  kLimitedVelocity = 2,
  kLimitedAcceleration = 4,
  kLimitedStep = 8,
  kLimitedJerk = 16,
};

// The last thing that happens to a command. Every command it returns keeps, against those before,
//
//   lower + margin <= x <= upper - margin,  |v| <= v_max,  |v dt| <= step,
//   |v - v_before| <= a_max dt,  |a - a_before| <= j_max dt   (joints)
//
// where v = (x - x_before) / dt and a = (v - v_before) / dt. From every command that it returns the
// axis can brake to rest inside the box under the same bounds, so they never contradict each other.
// A target is followed exactly where it can be; where it jumps, the distance to the moving target
// is closed so that a step in the target makes no overshoot. A target that is not finite counts as
// no target: the axis brakes.
//
// Braking law of a gap: with w the speed of approach, the largest w whose remaining ticks w, w - a
// dt, w - 2 a dt, ... cover no more than the gap. Braking to rest under bounded jerk is that law
// for the velocity as the gap and the acceleration as its speed.
//
// dt is the control period, not the time that passed: after a late tick the arm is moved less,
// never more.
//
// Allocates nothing. One thread.
class CommandLimiter {
 public:
  // FAILED_PRECONDITION where an axis has no room between its limits, or a bound is not positive.
  // The arm's own velocity and acceleration limits apply where they are lower than the options'.
  absl::Status Configure(const LimiterOptions& options, const ArmLimits& arm, double period_s);

  // The arm stands at `position`: the first command starts there, at rest. A measured position
  // outside the box is kept as it is and only moves inwards.
  void Reset(const ArmVector& position);
  // The next command towards `target`.
  ArmVector Limit(const ArmVector& target);
  // The next command of braking every axis to rest and staying there.
  ArmVector Decelerate();

  const ArmVector& position() const { return position_; }          // the last command
  const ArmVector& velocity() const { return velocity_; }          // [rad/s], [m/s]
  const ArmVector& acceleration() const { return acceleration_; }  // [rad/s^2], [m/s^2]
  bool at_rest() const;
  // After so many calls of Decelerate an axis that Limit moved is at rest, whatever it did before.
  int BrakingTicks(int axis) const;
  uint8_t flags() const { return flags_; }  // of the last Limit or Decelerate

 private:
  struct Axis {
    double lower = 0, upper = 0, velocity = 0, acceleration = 0, jerk = 0, step = 0;
  };
  struct Motion {  // of an axis, in the base frame or in a target's
    double x = 0, v = 0, a = 0;
  };
  struct Way {  // of braking to rest
    double end = 0, lowest = 0, highest = 0, fastest = 0;
  };
  void Advance(int axis, double target);  // NaN: brake
  // With bounded jerk: the next acceleration.
  double Accelerate(int axis, double target);
  double TowardsTarget(const Axis& axis, const Motion& now, int i, double target);
  double WithinBounds(const Axis& axis, const Motion& now, double wanted);
  double BrakingStep(const Axis& axis, double v, double a) const;
  Way Brake(const Axis& axis, Motion motion) const;
  Motion After(const Motion& now, double a) const;

  std::array<Axis, kMostAxes> axes_{};
  int count_ = 0;  // of axes that there are
  double dt_ = 0;  // [s]
  ArmVector position_{}, velocity_{}, acceleration_{};
  ArmVector last_target_{};  // NaN: none
  ArmVector last_drift_{};   // velocity of the target before; NaN: none
  uint8_t flags_ = 0;
};

// The braking law: the largest w >= 0 [1/s] for a gap >= 0, deceleration [1/s^2] and tick [s].
double BrakingSpeed(double gap, double deceleration, double dt);

}  // namespace robostress
