#include "robot_client/control/command_limiter.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kRest = 1e-9;
// Rounding in sums of a few terms; far below the bus's resolution of 17 micro-radians.
constexpr double kRounding = 1e-12;

}  // namespace

double BrakingSpeed(double gap, double deceleration, double dt) {
  if (!(gap > 0)) return 0;
  // With n full decrements left the distance is w dt (n + 1) - a dt^2 n (n + 1) / 2, which fits for
  // the n with n a dt <= w < (n + 1) a dt. n from the gap at which w = n a dt exactly:
  // a dt^2 n (n + 1) / 2 <= gap.
  const double unit = deceleration * dt * dt;
  const double n = std::floor((std::sqrt(1 + 8 * gap / unit) - 1) / 2);
  return (gap + unit * n * (n + 1) / 2) / (dt * (n + 1));
}

absl::Status CommandLimiter::Configure(const LimiterOptions& options, const ArmLimits& arm,
                                       double period_s) {
  if (!(period_s > 0 && std::isfinite(period_s))) {
    return absl::InvalidArgumentError(
        absl::StrCat("the control period is ", period_s, " s; it must be positive"));
  }
  dt_ = period_s;
  for (int i = 0; i < kArmAxes; ++i) {
    const bool joint = i < kArmJoints;
    const double margin = joint ? options.joint_margin : 0;
    Axis& axis = axes_[i];
    axis.lower = arm.lower[i] + margin;
    axis.upper = arm.upper[i] - margin;
    axis.velocity =
        std::min(joint ? options.joint_velocity : options.gripper_velocity, arm.max_velocity[i]);
    axis.acceleration = std::min(joint ? options.joint_acceleration : options.gripper_acceleration,
                                 arm.max_acceleration[i]);
    axis.step = joint ? options.joint_step : options.gripper_step;
    const std::string name = joint ? absl::StrCat("J", i + 1) : "gripper";
    if (!(axis.upper > axis.lower)) {
      return absl::FailedPreconditionError(absl::StrCat(name, " may move from ", axis.lower, " to ",
                                                        axis.upper, " after margins of ", margin,
                                                        ": no room; check the limits stored in the "
                                                        "arm and limits.joint_margin"));
    }
    if (!(axis.velocity > 0 && axis.acceleration > 0 && axis.step > 0 &&
          std::isfinite(axis.velocity + axis.acceleration + axis.step))) {
      return absl::FailedPreconditionError(
          absl::StrCat(name, " has velocity limit ", axis.velocity, ", acceleration limit ",
                       axis.acceleration, ", step limit ", axis.step,
                       "; all must be positive: check section limits and the "
                       "limits stored in the arm"));
    }
  }
  return absl::OkStatus();
}

void CommandLimiter::Reset(const ArmVector& position) {
  position_ = position;
  velocity_.fill(0);
  last_target_.fill(kNone);
  flags_ = 0;
}

bool CommandLimiter::at_rest() const {
  return std::all_of(velocity_.begin(), velocity_.end(),
                     [](double v) { return std::abs(v) < kRest; });
}

void CommandLimiter::Advance(int i, double target) {
  const Axis& axis = axes_[i];
  const double speed = std::min(axis.velocity, axis.step / dt_);
  const double change = axis.acceleration * dt_;
  double& x = position_[i];
  double v = 0;
  if (std::isfinite(target)) {
    const double inside = std::clamp(target, axis.lower, axis.upper);
    if (inside != target) flags_ |= kLimitedPosition;
    // The target's own motion, which needs no braking.
    const double drift = std::isfinite(last_target_[i])
                             ? std::clamp((inside - last_target_[i]) / dt_, -speed, speed)
                             : 0;
    last_target_[i] = inside;
    const double gap = inside - x - drift * dt_;
    v = drift + std::copysign(BrakingSpeed(std::abs(gap), axis.acceleration, dt_), gap);
    if (std::abs(v * dt_ - (inside - x)) > kRounding) flags_ |= kLimitedAcceleration;
  } else {
    last_target_[i] = kNone;
  }
  if (std::abs(v) > speed) {
    flags_ |= axis.velocity <= axis.step / dt_ ? kLimitedVelocity : kLimitedStep;
    v = std::clamp(v, -speed, speed);
  }
  if (std::abs(v - velocity_[i]) > change + kRounding) flags_ |= kLimitedAcceleration;
  v = std::clamp(v, velocity_[i] - change, velocity_[i] + change);
  // Slow enough to stop inside the box; an axis that is outside only moves inwards.
  const double up = BrakingSpeed(axis.upper - x, axis.acceleration, dt_);
  const double down = BrakingSpeed(x - axis.lower, axis.acceleration, dt_);
  const double bounded = std::clamp(v, -down, up);
  if (std::abs(bounded - v) > kRounding) flags_ |= kLimitedPosition;
  velocity_[i] = bounded;
  x += bounded * dt_;
}

ArmVector CommandLimiter::Limit(const ArmVector& target) {
  flags_ = 0;
  for (int i = 0; i < kArmAxes; ++i) Advance(i, target[i]);
  return position_;
}

ArmVector CommandLimiter::Decelerate() {
  flags_ = 0;
  for (int i = 0; i < kArmAxes; ++i) Advance(i, kNone);
  return position_;
}

}  // namespace robostress
