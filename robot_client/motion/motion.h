#pragma once

#include <array>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "robot_client/arm_model.h"
#include "robot_client/arm_path.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// A motion that was designed or recorded: poses over time.
struct Motion {
  std::string source;                   // what it came from, for people and records
  std::vector<double> t;                // [s], increasing, the first 0
  std::vector<ArmVector> poses;         // as many: joints [rad], opening [m]
  std::array<bool, kMostAxes> moves{};  // axes that it gives; the others stay where they are
  ArmAxes axes;                         // of the arm that it is for
  double duration_s() const { return t.empty() ? 0 : t.back(); }
};

// The longest that is played [s], and the most poses.
inline constexpr double kLongestMotion_s = 600;
inline constexpr size_t kMostPoses = 600'000;

// INVALID_ARGUMENT names source, time, axis and value: times that do not increase from 0, numbers
// that are none, a pose outside of what the arm allows, a motion that is too short or too long. An
// arm that a hand pushed against its end measures a little beyond it: 0.01 rad and 50 mm are let
// pass, and the limiter keeps the command inside.
absl::Status CheckMotion(const Motion& motion, const ArmLimits& limits);

// The motion as the control loop plays it, one row per `period_s`: straight from `from` to its
// first pose within `approach`, half a second there, then the motion, between its poses by monotone
// cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980), which never leave the range of their
// two ends. At `speed` below 1 no joint is faster than that share of the motion's own top speed:
// what is slow keeps its pace, what is fast is slowed down, by 1 / speed at most.
struct PlayedMotion {
  ArmAxes axes;
  ArmPath path;
  size_t first_row = 0;  // of the motion itself
};
PlayedMotion PlayMotion(const Motion& motion, double speed, const ArmVector& from,
                        const PathLimits& approach, double period_s);

// FAILED_PRECONDITION where a joint of the motion's own rows would be faster than `velocity`
// [rad/s]: names it, when, and the speed at which it is not.
absl::Status CheckSpeed(const PlayedMotion& played, double speed, double velocity, double period_s);

// The motion as a table: t, q_cmd_J1 .., q_cmd_gripper of the axes that it moves.
std::string MotionCsv(const Motion& motion);

}  // namespace robostress
