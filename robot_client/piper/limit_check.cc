#include "robot_client/piper/limit_check.h"

#include <algorithm>
#include <limits>

#include "absl/strings/str_format.h"
#include "common/check.h"
#include "robot_client/piper/kinematics.h"

namespace robostress::piper {
namespace {

constexpr double kResolution = 0.002;        // [rad] of the answer, 0.1 degrees, rounded up
constexpr double kSmallestRange = 0.5;       // [rad]
constexpr Range kSpeeds = {0.5, 3.5};        // [rad/s]
constexpr Range kAccelerations = {0.5, 20};  // [rad/s^2]
constexpr double kGripperSpeed = 0.2;        // [m/s], what a client may ask for; the arm names none
constexpr double kGripperAcceleration = 2;   // [m/s^2], likewise

absl::Status Unfit(int joint, const char* field, double value, const char* unit,
                   const Range& expected) {
  return absl::FailedPreconditionError(absl::StrFormat(
      "joint %d answers %s = %.4f %s, expected %.4f to %.4f; the arm's settings are damaged or in "
      "other units: restore them with the vendor's tool",
      joint + 1, field, value, unit, expected.lower, expected.upper));
}

bool Within(double value, const Range& range) {
  return value >= range.lower && value <= range.upper;
}

}  // namespace

absl::Status CheckJointLimit(const JointLimit& limit, const JointAcceleration& acceleration) {
  const Range stops = {kJointStops[limit.joint].lower - kResolution,
                       kJointStops[limit.joint].upper + kResolution};
  if (!Within(limit.lower, stops)) return Unfit(limit.joint, "lower", limit.lower, "rad", stops);
  if (!Within(limit.upper, {limit.lower + kSmallestRange, stops.upper}))
    return Unfit(limit.joint, "upper", limit.upper, "rad",
                 {limit.lower + kSmallestRange, stops.upper});
  if (!Within(limit.max_speed, kSpeeds))
    return Unfit(limit.joint, "max_speed", limit.max_speed, "rad/s", kSpeeds);
  if (!Within(acceleration.max_acceleration, kAccelerations))
    return Unfit(limit.joint, "max_acceleration", acceleration.max_acceleration, "rad/s^2",
                 kAccelerations);
  return absl::OkStatus();
}

ArmLimits UsableLimits(const std::array<std::optional<JointLimit>, kJoints>& limits,
                       const std::array<std::optional<JointAcceleration>, kJoints>& accelerations,
                       double gripper_range, double margin) {
  ArmLimits usable;
  for (int j = 0; j < kJoints; ++j) {
    RS_CHECK(limits[j].has_value() && accelerations[j].has_value());
    usable.lower[j] = std::max(limits[j]->lower, kJointRanges[j].lower) + margin;
    usable.upper[j] = std::min(limits[j]->upper, kJointRanges[j].upper) - margin;
    usable.max_velocity[j] = std::min(limits[j]->max_speed, kMaxJointSpeed);
    usable.max_acceleration[j] = accelerations[j]->max_acceleration;
  }
  usable.lower[kJoints] = 0;
  usable.upper[kJoints] = gripper_range;
  usable.max_velocity[kJoints] = kGripperSpeed;
  usable.max_acceleration[kJoints] = kGripperAcceleration;
  return usable;
}

}  // namespace robostress::piper
