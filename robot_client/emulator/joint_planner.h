#pragma once

#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// The reference of one joint in move mode J: towards the newest target with a trapezoidal velocity
// profile that is planned anew every step from the reference's present position and velocity.
//   v_wanted = sign(e) min(v_max, sqrt(2 a_max |e|)), |dv / dt| <= a_max, e = target - p.
// A stream of targets is followed with a distance of v^2 / (2 a_max), as trapezoids do.
class JointPlanner {
 public:
  void Reset(double position) {
    position_ = target_ = position;
    velocity_ = 0;
  }
  void SetTarget(double target) { target_ = target; }
  // The reference is here and moves so; the target stays.
  void Go(double position, double velocity) {
    position_ = position;
    velocity_ = velocity;
  }
  // The reference follows somebody else's plan; where it is becomes the target.
  void Follow(double position, double velocity) {
    position_ = target_ = position;
    velocity_ = velocity;
  }
  // One step of braking to a stop; where the reference then is becomes the target.
  void Brake(double max_acceleration, double h);
  // The reference becomes the target at once (follow mode kDirect).
  void Jump() {
    position_ = target_;
    velocity_ = 0;
  }
  void Step(double max_velocity, double max_acceleration, double h);

  double position() const { return position_; }  // [rad]
  double velocity() const { return velocity_; }  // [rad/s]
  double target() const { return target_; }
  bool at_target() const { return position_ == target_ && velocity_ == 0; }

 private:
  double position_ = 0, velocity_ = 0, target_ = 0;
};

}  // namespace robostress::piper
