#include "robot_client/motion/motion.h"

#include <math.h>  // Boost 1.74's pchip calls isnan without a namespace

#include <algorithm>
#include <boost/math/interpolators/pchip.hpp>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress {
namespace {

constexpr double kStands_s = 0.5;  // before the motion's first row
// Beyond the arm's limits that a pose may be measured: joints [rad], gripper [m].
constexpr double kMeasuredBeyond = 0.01, kMeasuredOpening = 0.05;
// Boost's cubics want four points at least; a motion of fewer is none.
constexpr size_t kFewestPoses = 4;

// Values of one axis over the motion's time.
class AxisCurve {
 public:
  AxisCurve(const Motion& motion, int axis)
      : first_(motion.t.front()),
        last_(motion.t.back()),
        curve_(std::vector<double>(motion.t), Column(motion, axis)) {}
  double At(double t) const { return curve_(std::clamp(t, first_, last_)); }
  double SpeedAt(double t) const { return std::abs(curve_.prime(std::clamp(t, first_, last_))); }

 private:
  static std::vector<double> Column(const Motion& motion, int axis) {
    std::vector<double> column;
    column.reserve(motion.poses.size());
    for (const ArmVector& pose : motion.poses) column.push_back(pose[axis]);
    return column;
  }
  double first_, last_;
  boost::math::interpolators::pchip<std::vector<double>> curve_;
};

}  // namespace

absl::Status CheckMotion(const Motion& motion, const ArmLimits& limits) {
  const auto invalid = [&](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(motion.source, ": ", parts...));
  };
  if (motion.t.size() != motion.poses.size() || motion.t.size() < kFewestPoses ||
      motion.t.size() > kMostPoses)
    return invalid("holds ", motion.poses.size(), " poses at ", motion.t.size(), " times; from ",
                   kFewestPoses, " to ", kMostPoses, " are played");
  if (std::none_of(motion.moves.begin(), motion.moves.end(), [](bool moves) { return moves; }))
    return invalid("moves no axis; give columns q_cmd_J1 to q_cmd_J", limits.axes.joints);
  for (size_t i = 0; i < motion.t.size(); ++i) {
    const double t = motion.t[i];
    if (!(i == 0 ? t == 0 : t > motion.t[i - 1]) || !(t <= kLongestMotion_s))
      return invalid("time ", i, " is ", t, " s", i == 0 ? "" : " after ",
                     i == 0 ? "" : absl::StrCat(motion.t[i - 1], " s"),
                     "; times begin at 0, increase, and end by ", kLongestMotion_s, " s");
    for (int axis = 0; axis < limits.axes.count(); ++axis) {
      const double value = motion.poses[i][axis];
      const double beyond = axis < limits.axes.joints ? kMeasuredBeyond : kMeasuredOpening;
      // Written so that a NaN is refused.
      if (motion.moves[axis] &&
          !(value >= limits.lower[axis] - beyond && value <= limits.upper[axis] + beyond))
        return invalid(absl::StrFormat("at t = %.3f s %s is %.4f, the arm allows %.4f to %.4f", t,
                                       limits.axes.name(axis), value, limits.lower[axis],
                                       limits.upper[axis]));
    }
  }
  return absl::OkStatus();
}

PlayedMotion PlayMotion(const Motion& motion, double speed, const ArmVector& from,
                        const PathLimits& approach, double period_s) {
  ArmVector start = from;
  std::vector<std::pair<int, AxisCurve>> curves;
  const ArmAxes& axes = motion.axes;
  for (int axis = 0; axis < axes.count(); ++axis) {
    if (!motion.moves[axis]) continue;
    start[axis] = motion.poses.front()[axis];
    curves.emplace_back(axis, AxisCurve(motion, axis));
  }
  const auto fastest_at = [&](double t) {
    double fastest = 0;
    for (const auto& [axis, curve] : curves)
      fastest = std::max(fastest, axis < axes.joints ? curve.SpeedAt(t) : 0);
    return fastest;
  };
  double top = 0;
  for (double t = 0; t < motion.duration_s(); t += period_s / 2) top = std::max(top, fastest_at(t));

  PlayedMotion played{axes, StraightPath(axes, from, start, approach, period_s)};
  std::vector<ArmVector>& rows = played.path.rows;
  rows.insert(rows.end(), static_cast<size_t>(std::ceil(kStands_s / period_s)), start);
  played.first_row = rows.size();
  for (double t = 0; true;) {
    ArmVector row = start;
    for (const auto& [axis, curve] : curves) row[axis] = curve.At(t);
    rows.push_back(row);
    if (t >= motion.duration_s() - 1e-9) return played;
    // At its beginning a step knows nothing of the speed at its end.
    double pace = 1;
    for (int i = 0; i < 3; ++i) {
      const double fastest = std::max(
          {fastest_at(t), fastest_at(t + pace * period_s / 2), fastest_at(t + pace * period_s)});
      if (fastest * pace > speed * top) pace = std::max(speed, speed * top / fastest);
    }
    t = std::min(t + pace * period_s, motion.duration_s());
  }
}

absl::Status CheckSpeed(const PlayedMotion& played, double speed, double velocity,
                        double period_s) {
  const std::vector<ArmVector>& rows = played.path.rows;
  double fastest = 0, at_s = 0;
  int joint = 0;
  for (size_t i = played.first_row + 1; i < rows.size(); ++i) {
    for (int j = 0; j < played.axes.joints; ++j) {
      const double v = std::abs(rows[i][j] - rows[i - 1][j]) / period_s;
      if (v <= fastest) continue;
      fastest = v;
      joint = j;
      at_s = static_cast<double>(i - played.first_row) * period_s;
    }
  }
  if (fastest <= velocity * (1 + 1e-6)) return absl::OkStatus();
  const double fits = std::floor(99 * speed * velocity / fastest) / 100;
  return absl::FailedPreconditionError(absl::StrFormat(
      "%s would reach %.2f rad/s at t = %.1f s, control.limits.joint_velocity is %.2f; %s",
      played.axes.name(joint), fastest, at_s, velocity,
      fits >= 0.01 ? absl::StrFormat("type play %.2f, or raise the limit", fits)
                   : "raise the limit, or give a slower motion"));
}

std::string MotionCsv(const Motion& motion) {
  std::string text = "t";
  for (int axis = 0; axis < motion.axes.count(); ++axis) {
    if (motion.moves[axis]) absl::StrAppend(&text, ",q_cmd_", motion.axes.name(axis));
  }
  for (size_t i = 0; i < motion.t.size(); ++i) {
    absl::StrAppendFormat(&text, "\n%.9g", motion.t[i]);
    for (int axis = 0; axis < motion.axes.count(); ++axis) {
      if (motion.moves[axis]) absl::StrAppendFormat(&text, ",%.9g", motion.poses[i][axis]);
    }
  }
  return text + "\n";
}

}  // namespace robostress
