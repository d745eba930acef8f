#pragma once

#include <Eigen/Core>

#include "common/types.h"
#include "common/unit_config.h"

namespace robostress {

// How the delta controller of a nominal arm (robosuite's OSC_POSE) answers a normalised command.
struct NominalArmOptions {
  GoalReference goal_reference = GoalReference::kAchieved;
  double control_period_s = 0.05;   // [s] between commands
  int sub_steps = 25;               // physics steps per command
  double kp = 150;                  // [1/s^2]
  double damping_ratio = 1;         // kd = 2 * damping_ratio * sqrt(kp) [1/s]
  bool panda_dynamics = false;      // C and d of panda_dynamics.h; else the identity and 0
  double translation_scale = 0.05;  // of commands, for C and d [m]
  double rotation_scale = 0.5;      // [rad]
};

// Displacement that a nominal Clean arm gives to a sequence of commands. With gravity compensated
// the controller leaves a unit mass on each axis; under OSC_POSE they are coupled, and drift:
//
//   goal = x + a  (achieved)   or   goal = goal + a  (desired)       at the start of a control step
//   v <- v + h (C (kp (goal - x) - kd v) + d),   x <- x + h v        per sub-step, semi-implicit
//   Euler
//
// x, v, goal are in normalised command units (1 = 0.05 m or 0.5 rad), so the same filter serves all
// six axes. The velocity is carried along the episode. As in OSC_POSE the rotation goal stays where
// it was when all three rotation commands are exactly zero. Constant command, C = 1, d = 0:
// steady gain 0.267 for achieved, 1 for desired.
class NominalArm {
 public:
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  // x is measured from the start of the current control step.
  struct State {
    Vector6 goal = Vector6::Zero();      // relative to x
    Vector6 velocity = Vector6::Zero();  // [1/s]
  };

  explicit NominalArm(const NominalArmOptions& options) : options_(options) {}

  void Reset() { state_ = {}; }  // at rest, goal reached; start of an episode
  // Above every state of an arm that settles (a control period of up to 1.6 s); the
  // semi-implicit steps of a longer one do not, and their state is left as it was.
  static constexpr double kMaxState = 1e6;

  // One control step; `command` is clipped to +-1 as the controller does. `before`: the arm at its
  // start, for C and d. Returns the displacement [6]; zero where the state would pass kMaxState,
  // which then stays.
  Vector6 Step(const Vector6& command, const RobotState& before = {});

  const State& state() const { return state_; }
  void set_state(const State& state) { state_ = state; }
  // Every entry is a number and at most kMaxState.
  static bool Holds(const State& state);

 private:
  NominalArmOptions options_;
  State state_;
};

}  // namespace robostress
