#include "robot_client/control/held_arm.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

// [rad], [m]. An arm without power hangs in its mechanical stops, up to 0.1 rad beyond J1, J3, J4,
// J5.
constexpr double kRestOutside = 0.12;
constexpr double kStrained = 0.5;  // of its limit: a joint that stands gives way to the torque ...
constexpr double kGiveWay = 0.02;  // [rad] ... by this much at a time ...
constexpr double kMostWay = 0.2;   // [rad] ... and no further in all

}  // namespace

absl::Status MoveInside(const ArmLimits& limits, ArmVector& position) {
  for (int i = 0; i < limits.axes.count(); ++i) {
    const double inside = std::clamp(position[i], limits.lower[i], limits.upper[i]);
    if (std::abs(inside - position[i]) > kRestOutside) {
      return absl::FailedPreconditionError(absl::StrCat(
          i < limits.axes.joints ? limits.axes.name(i) : "the gripper", " stands at ", position[i],
          ", outside ", limits.lower[i], " to ", limits.upper[i], " by more than ", kRestOutside,
          ": take its power off, move it by hand, enable again"));
    }
    position[i] = inside;
  }
  return absl::OkStatus();
}

void HeldArm::Begin(const ArmVector& measured) {
  target_.reset();
  relaxed_ = false;
  pushed_.fill(0);
  stood_at_ = measured;
}

void HeldArm::Take(const TickRecord& record, const PressWatch& press, bool held,
                   const ArmVector& command, bool at_rest) {
  const bool stands =
      std::all_of(record.velocity.begin(), record.velocity.begin() + record.axes.joints,
                  [](double v) { return std::abs(v) < kStill; });
  const bool settled = stands && at_rest;
  const bool first = held && !relaxed_ && settled;
  ArmVector to = target_.value_or(command);
  bool gives_way = false;
  for (int j = 0; j < record.axes.joints; ++j) {
    const double share = press.share(j);
    if (std::abs(share) > kStrained && (settled || press.pressing())) {
      const double away = record.position[j] - std::copysign(kGiveWay, share);
      to[j] = std::clamp(away, stood_at_[j] - kMostWay, stood_at_[j] + kMostWay);
      gives_way = true;
    } else if (first && (pushed_[j] != 0 || std::abs(to[j] - record.position[j]) > kRelax)) {
      to[j] = record.position[j] - kGiveWay * pushed_[j];
      gives_way = true;
    }
  }
  if (gives_way) {
    target_ = to;
  } else if (settled) {
    target_.reset();
  }
  relaxed_ = relaxed_ || first;
}

std::optional<ArmVector> HeldArm::LetGo(const ArmLimits& limits, const ArmVector& measured,
                                        const ArmVector& command) {
  ArmVector stand = measured;
  if (!MoveInside(limits, stand).ok()) return std::nullopt;
  const int opening = limits.axes.opening();
  stand[opening] = command[opening];
  for (int j = 0; j < limits.axes.joints; ++j) {
    const double ahead = command[j] - stand[j];
    pushed_[j] = std::abs(ahead) > kRelax ? std::copysign(1.0, ahead) : 0;
  }
  return stand;
}

}  // namespace robostress
