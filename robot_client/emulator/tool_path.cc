#include "robot_client/emulator/tool_path.h"

#include <algorithm>
#include <cmath>

namespace robostress::piper {
namespace {

constexpr double kSmallest = 1e-9;  // way [m] or turn [rad] that counts as one

// Angle of a point seen along the arc, 0 .. 2 pi.
double AngleOn(const Eigen::Vector3d& r, const Eigen::Vector3d& e1, const Eigen::Vector3d& e2) {
  const double angle = std::atan2(r.dot(e2), r.dot(e1));
  return angle < 0 ? angle + 2 * M_PI : angle;
}

}  // namespace

void ToolPath::Start(double length, double angle) {
  length_ = length;
  angle_ = angle;
  before_ = 0;
  active_ = true;
  share_.Reset(0);
  share_.SetTarget(1);
}

void ToolPath::StartLine(const ToolTarget& from, const ToolTarget& to,
                         const Eigen::Vector3d& along) {
  from_ = from;
  to_ = to;
  arc_ = false;
  const Eigen::Vector3d way = to.p - from.p;
  Start(way.norm(), from.R.angularDistance(to.R));
  if (length_ > kSmallest) share_.Go(0, std::max(0.0, along.dot(way)) / (length_ * length_));
}

bool ToolPath::StartArc(const ToolTarget& start, const ToolTarget& middle, const ToolTarget& end) {
  active_ = false;
  // The circumscribed circle's centre, from the triangle's sides a and b at its start.
  const Eigen::Vector3d a = middle.p - start.p, b = end.p - start.p, normal = a.cross(b);
  if (normal.norm() < 1e-3 * a.norm() * b.norm() || normal.squaredNorm() == 0) return false;
  const Eigen::Vector3d to_centre =
      (b.squaredNorm() * normal.cross(a) - a.squaredNorm() * normal.cross(b)) /
      (2 * normal.squaredNorm());
  centre_ = start.p + to_centre;
  e1_ = -to_centre;
  e2_ = normal.normalized().cross(e1_);
  from_ = start;
  middle_ = middle;
  to_ = end;
  arc_ = true;
  middle_angle_ = AngleOn(middle.p - centre_, e1_, e2_);
  arc_angle_ = AngleOn(end.p - centre_, e1_, e2_);
  Start(arc_angle_ * e1_.norm(),
        start.R.angularDistance(middle.R) + middle.R.angularDistance(end.R));
  return true;
}

void ToolPath::Step(const ToolLimits& limits, int percent, double h) {
  before_ = share_.position();
  const double way = std::max(length_, kSmallest), turn = std::max(angle_, kSmallest);
  const double speed = std::min(limits.velocity / way, limits.angular_velocity / turn);
  const double acceleration =
      std::min(limits.acceleration / way, limits.angular_acceleration / turn);
  share_.Step(speed * percent / 100, acceleration, h);
}

void ToolPath::SlowDown(double part) {
  share_.Go(before_ + part * (share_.position() - before_), part * share_.velocity());
}

ToolTarget ToolPath::target() const {
  const double u = share_.position();
  if (!arc_) return {from_.p + u * (to_.p - from_.p), from_.R.slerp(u, to_.R)};
  const double angle = u * arc_angle_;
  const Eigen::Vector3d p = centre_ + std::cos(angle) * e1_ + std::sin(angle) * e2_;
  if (angle < middle_angle_) return {p, from_.R.slerp(angle / middle_angle_, middle_.R)};
  return {p, middle_.R.slerp((angle - middle_angle_) / (arc_angle_ - middle_angle_), to_.R)};
}

Eigen::Vector3d ToolPath::velocity() const {
  if (!active_ || arc_) return Eigen::Vector3d::Zero();
  return share_.velocity() * (to_.p - from_.p);
}

}  // namespace robostress::piper
