#pragma once

#include <cstdint>

#include "absl/status/statusor.h"
#include "robot_client/arm_model.h"
#include "robot_client/motion/motion.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// How an arm is moved so that `robostress calibrate` can tell friction, gravity, backlash and
// compliance apart.
struct ExcitationOptions {
  ArmVector centre{};             // around which it moves; the opening stays
  double most_swing = 0.4;        // [rad] each way
  double joint_velocity = 0.8;    // [rad/s]
  double joint_acceleration = 3;  // [rad/s^2]
  double clearance = 0.03;        // [m] from table, box and the arm itself
  double together_s = 30;         // of all joints at once
  uint64_t seed = 1;              // of that part's phases
};

// A motion of two minutes in two parts. First, three times, every joint alone, the others still:
// there and back to both sides, by a fifth, a half and all of its swing, with peaks of 1/8, 1/2 and
// all of the velocity; slow ways show friction over speed, turns show backlash. Then all joints at
// once, each a Fourier series of five harmonics of its own, which shows inertia and gravity
// (Swevers et al., IEEE Trans. Robotics and Automation 13, 1997), faded in and out over 2 s.
//
// Every swing is as large as limits and workspace allow. FAILED_PRECONDITION
// where a joint has less than 0.05 rad: names joint and bound. `model` may be null: limits alone.
absl::StatusOr<Motion> DesignExcitation(const ExcitationOptions& options, const ArmLimits& limits,
                                        const ArmModel* model);

}  // namespace robostress
