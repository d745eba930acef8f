#include "robot_client/control/command_limiter.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kRest = 1e-9;
constexpr double kAtRest = 1e-6;  // [rad/s] a target is approached ever more slowly
// A target counts as followed when braking would end this close to it [rad].
constexpr double kFollowed = 1e-10;
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
  count_ = arm.axes.count();
  for (int i = 0; i < count_; ++i) {
    const bool joint = i < arm.axes.joints;
    const double margin = joint ? options.joint_margin : 0;
    Axis& axis = axes_[i];
    axis.lower = arm.lower[i] + margin;
    axis.upper = arm.upper[i] - margin;
    axis.velocity =
        std::min(joint ? options.joint_velocity : options.gripper_velocity, arm.max_velocity[i]);
    axis.acceleration = std::min(joint ? options.joint_acceleration : options.gripper_acceleration,
                                 arm.max_acceleration[i]);
    axis.jerk = joint ? options.joint_jerk : std::numeric_limits<double>::infinity();
    axis.step = joint ? options.joint_step : options.gripper_step;
    const std::string name = arm.axes.name(i);
    if (!(axis.upper > axis.lower)) {
      return absl::FailedPreconditionError(absl::StrCat(name, " may move from ", axis.lower, " to ",
                                                        axis.upper, " after margins of ", margin,
                                                        ": no room; check the limits stored in the "
                                                        "arm and limits.joint_margin"));
    }
    if (!(axis.velocity > 0 && axis.acceleration > 0 && axis.step > 0 && axis.jerk > 0 &&
          std::isfinite(axis.velocity + axis.acceleration + axis.step))) {
      return absl::FailedPreconditionError(
          absl::StrCat(name, " has velocity limit ", axis.velocity, ", acceleration limit ",
                       axis.acceleration, ", jerk limit ", axis.jerk, ", step limit ", axis.step,
                       "; all must be positive: check section limits and the "
                       "limits stored in the arm"));
    }
  }
  return absl::OkStatus();
}

void CommandLimiter::Reset(const ArmVector& position) {
  position_ = position;
  velocity_.fill(0);
  acceleration_.fill(0);
  last_target_.fill(kNone);
  last_drift_.fill(kNone);
  flags_ = 0;
}

bool CommandLimiter::at_rest() const {
  for (int i = 0; i < count_; ++i) {
    // One that turns back has no velocity either, but will have.
    if (!(std::abs(velocity_[i]) < kAtRest && std::abs(acceleration_[i] * dt_) < kAtRest))
      return false;
  }
  return true;
}

int CommandLimiter::BrakingTicks(int i) const {
  const Axis& axis = axes_[i];
  const double v = std::min(axis.velocity, axis.step / dt_), a = axis.acceleration, j = axis.jerk;
  // First it lets go of an acceleration, which changes the velocity by 2 v at most, then it brakes.
  const double lets_go = std::min(a, 2 * std::sqrt(j * v)) / j;
  const double brakes = v > a * a / j ? v / a + a / j : 2 * std::sqrt(v / j);
  return static_cast<int>(std::min(std::ceil((lets_go + brakes) / dt_) + 3, 1e9));
}

CommandLimiter::Motion CommandLimiter::After(const Motion& now, double a) const {
  const double v = now.v + a * dt_;
  return {now.x + v * dt_, v, a};
}

// The next acceleration of coming to rest: of what is left of the velocity.
double CommandLimiter::BrakingStep(const Axis& axis, double v, double a) const {
  const double wanted =
      -std::copysign(std::min(BrakingSpeed(std::abs(v), axis.jerk, dt_), axis.acceleration), v);
  const double change = axis.jerk * dt_;
  return std::clamp(wanted, a - change, a + change);
}

CommandLimiter::Way CommandLimiter::Brake(const Axis& axis, Motion motion) const {
  constexpr int kMostTicks = 1000;
  Way way{motion.x, motion.x, motion.x, std::abs(motion.v)};
  for (int i = 0; i < kMostTicks; ++i) {
    if (std::abs(motion.v) < kRest && std::abs(motion.a) < kRest) break;
    motion = After(motion, BrakingStep(axis, motion.v, motion.a));
    way.lowest = std::min(way.lowest, motion.x);
    way.highest = std::max(way.highest, motion.x);
    way.fastest = std::max(way.fastest, std::abs(motion.v));
  }
  way.end = motion.x;
  return way;
}

// The acceleration after which braking ends on the target, seen from a target that goes on with
// the velocity and the acceleration it has.
double CommandLimiter::TowardsTarget(const Axis& axis, const Motion& now, int i, double target) {
  const double drift = std::isfinite(last_target_[i]) ? std::clamp((target - last_target_[i]) / dt_,
                                                                   -axis.velocity, axis.velocity)
                                                      : 0;
  const double bend =
      std::isfinite(last_drift_[i])
          ? std::clamp((drift - last_drift_[i]) / dt_, -axis.acceleration, axis.acceleration)
          : 0;
  last_target_[i] = target;
  last_drift_[i] = drift;
  const double change = axis.jerk * dt_;
  double low = std::max(now.a - change, -axis.acceleration);
  double high = std::min(now.a + change, axis.acceleration);
  const auto end = [&](double a) {
    Motion next = After(now, a);
    next.x -= target;
    next.v -= drift;
    next.a -= bend;
    return Brake(axis, next).end;
  };
  const double exact = ((target - now.x) / dt_ - now.v) / dt_;
  if (exact >= low - kRounding && exact <= high + kRounding && std::abs(end(exact)) < kFollowed)
    return exact;
  if (end(high) <= 0) return high;
  if (end(low) >= 0) return low;
  for (int k = 0; k < 32; ++k) {
    const double middle = 0.5 * (low + high);
    (end(middle) <= 0 ? low : high) = middle;
  }
  return low;
}

// The acceleration nearest to the wanted one from which the axis can still brake within its bounds.
double CommandLimiter::WithinBounds(const Axis& axis, const Motion& now, double wanted) {
  const double speed = std::min(axis.velocity, axis.step / dt_);
  const double upper = std::max(axis.upper, now.x), lower = std::min(axis.lower, now.x);
  uint8_t why = 0;
  const auto fits = [&](double a) {
    const Way way = Brake(axis, After(now, a));
    if (way.highest > upper + kRounding || way.lowest < lower - kRounding) {
      why = kLimitedPosition;
      return false;
    }
    if (way.fastest <= speed + kRounding) return true;
    why = axis.velocity <= axis.step / dt_ ? kLimitedVelocity : kLimitedStep;
    return false;
  };
  if (fits(wanted)) return wanted;
  flags_ |= why;
  double safe = BrakingStep(axis, now.v, now.a), beyond = wanted;
  for (int k = 0; k < 24; ++k) {
    const double middle = 0.5 * (safe + beyond);
    (fits(middle) ? safe : beyond) = middle;
  }
  return safe;
}

double CommandLimiter::Accelerate(int i, double target) {
  const Axis& axis = axes_[i];
  const Motion now{position_[i], velocity_[i], acceleration_[i]};
  if (!std::isfinite(target)) {
    last_target_[i] = last_drift_[i] = kNone;
    return BrakingStep(axis, now.v, now.a);
  }
  const double inside = std::clamp(target, axis.lower, axis.upper);
  if (inside != target) flags_ |= kLimitedPosition;
  const double wanted = TowardsTarget(axis, now, i, inside);
  const double a = WithinBounds(axis, now, wanted);
  if (a == wanted && std::abs(After(now, a).x - inside) > kRounding) {
    const bool most = std::abs(a) >= axis.acceleration - kRounding;
    flags_ |= most ? kLimitedAcceleration : kLimitedJerk;
  }
  return a;
}

void CommandLimiter::Advance(int i, double target) {
  const Axis& axis = axes_[i];
  if (std::isfinite(axis.jerk)) {
    const Motion next =
        After({position_[i], velocity_[i], acceleration_[i]}, Accelerate(i, target));
    const bool rests = std::abs(next.v) < kRest && std::abs(next.a) < kRest;
    position_[i] = next.x;
    velocity_[i] = rests ? 0 : next.v;
    acceleration_[i] = rests ? 0 : next.a;
    return;
  }
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
  for (int i = 0; i < count_; ++i) Advance(i, target[i]);
  return position_;
}

ArmVector CommandLimiter::Decelerate() {
  flags_ = 0;
  for (int i = 0; i < count_; ++i) Advance(i, kNone);
  return position_;
}

}  // namespace robostress
