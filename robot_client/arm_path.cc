#include "robot_client/arm_path.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"

namespace robostress {
namespace {

std::string Depth(const ArmModel& model, ArmModel::Bound bound, const ArmVector& pose) {
  const std::string parts = bound == ArmModel::kItself ? model.NearestParts(pose) : "";
  return absl::StrFormat("%.0f mm into %s%s", -1000 * model.ClearanceAt(pose)[bound],
                         BoundName(bound), parts.empty() ? "" : " (" + parts + ")");
}

}  // namespace

ArmPath StraightPath(const ArmAxes& axes, const ArmVector& from, const ArmVector& to,
                     const PathLimits& limits, double period_s) {
  double longest = 0;
  for (int j = 0; j < axes.joints; ++j) longest = std::max(longest, std::abs(to[j] - from[j]));
  const double opening = std::abs(to[axes.opening()] - from[axes.opening()]);
  const double seconds = std::max({1.875 * longest / limits.joint_velocity,
                                   std::sqrt(5.774 * longest / limits.joint_acceleration),
                                   std::cbrt(60 * longest / limits.joint_jerk),
                                   1.875 * opening / limits.gripper_velocity, period_s});
  const int rows = static_cast<int>(std::ceil(seconds / period_s));
  ArmPath path;
  for (int i = 1; i <= rows; ++i) {
    const double s = static_cast<double>(i) / rows;
    const double share = s * s * s * (10 - 15 * s + 6 * s * s);
    ArmVector row;
    for (int axis = 0; axis < kMostAxes; ++axis)
      row[axis] = from[axis] + share * (to[axis] - from[axis]);
    path.rows.push_back(row);
  }
  path.rows.back() = to;
  return path;
}

absl::Status CheckPath(const ArmModel& model, const ArmPath& path) {
  if (path.rows.empty()) return absl::InvalidArgumentError("the way has no rows");
  ArmModel::Clearance now = model.ClearanceAt(path.rows.front());
  for (const ArmVector& row : path.rows) {
    const ArmModel::Clearance next = model.ClearanceAt(row);
    const ArmModel::Bound bound = CrossedBound(now, next);
    if (bound != ArmModel::kBounds) {
      return absl::FailedPreconditionError(
          absl::StrCat("the way leads ", Depth(model, bound, row),
                       "; jog the arm clear of it first, or correct control.workspace"));
    }
    now = next;
  }
  return absl::OkStatus();
}

absl::Status CheckPose(const char* name, const ArmVector& pose, const ArmLimits& limits,
                       const ArmModel* model) {
  for (int i = 0; i < limits.axes.count(); ++i) {
    if (!(pose[i] >= limits.lower[i] && pose[i] <= limits.upper[i])) {
      return absl::InvalidArgumentError(
          absl::StrFormat("%s: %s is %.4f, the arm allows %.4f to %.4f", name,
                          i < limits.axes.joints ? limits.axes.name(i) : "the opening", pose[i],
                          limits.lower[i], limits.upper[i]));
    }
  }
  if (model == nullptr) return absl::OkStatus();
  const ArmModel::Bound bound = BrokenBound(model->ClearanceAt(pose));
  if (bound == ArmModel::kBounds) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, " lies ", Depth(*model, bound, pose),
                                                 "; correct it, or control.workspace"));
}

}  // namespace robostress
