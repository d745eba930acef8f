#include "robot_client/emulator/joint_planner.h"

#include <algorithm>
#include <cmath>

namespace robostress::piper {

void JointPlanner::Brake(double max_acceleration, double h) {
  velocity_ -= std::clamp(velocity_, -max_acceleration * h, max_acceleration * h);
  position_ += velocity_ * h;
  target_ = position_;
}

void JointPlanner::Step(double max_velocity, double max_acceleration, double h) {
  const double error = target_ - position_;
  const double change = max_acceleration * h;
  // Within one step of the target at a speed that one step can stop.
  if (std::abs(error) <= change * h && std::abs(velocity_) <= change) {
    Jump();
    return;
  }
  // The speed from which a_max still stops in time, with the distance of this step taken off.
  const double braking =
      std::sqrt(2 * max_acceleration * std::abs(error) + 0.25 * change * change) - 0.5 * change;
  const double wanted =
      std::copysign(std::min({max_velocity, braking, std::abs(error) / h}), error);
  velocity_ += std::clamp(wanted - velocity_, -change, change);
  position_ += velocity_ * h;
}

}  // namespace robostress::piper
