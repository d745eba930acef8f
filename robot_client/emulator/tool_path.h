#pragma once

#include <Eigen/Geometry>

#include "robot_client/emulator/arm_settings.h"
#include "robot_client/emulator/joint_planner.h"

namespace robostress::piper {

// Where the tool is to be in the base frame.
struct ToolTarget {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();            // [m]
  Eigen::Quaterniond R = Eigen::Quaterniond::Identity();  // of the tool in the base
};

// The reference of the tool in move modes L and C: along a straight line, or along the arc through
// three points, with a trapezoidal speed profile whose limits hold for the way and the turn. The
// orientation turns evenly with the way. u, 0 .. 1, is the share of the way.
class ToolPath {
 public:
  // From `from` with the speed `along` [m/s] in the direction of `to`.
  void StartLine(const ToolTarget& from, const ToolTarget& to, const Eigen::Vector3d& along);
  // False, and no path, for three points on one line.
  bool StartArc(const ToolTarget& start, const ToolTarget& middle, const ToolTarget& end);
  void Stop() { active_ = false; }
  bool active() const { return active_; }
  bool at_end() const { return share_.at_target(); }

  // One step of `h` seconds with `percent` of the limits' speeds.
  void Step(const ToolLimits& limits, int percent, double h);
  // Takes back what the last step went beyond this part of it, 0 .. 1: joints cannot follow faster.
  void SlowDown(double part);
  ToolTarget target() const;         // at the present share
  Eigen::Vector3d velocity() const;  // of the line, [m/s]; zero on an arc

 private:
  void Start(double length, double angle);

  bool active_ = false, arc_ = false;
  ToolTarget from_, middle_, to_;
  Eigen::Vector3d centre_, e1_, e2_;         // of the arc: p = centre + e1 cos + e2 sin
  double arc_angle_ = 0, middle_angle_ = 0;  // [rad]
  double length_ = 0, angle_ = 0;            // of the whole way [m], [rad]
  JointPlanner share_;
  double before_ = 0;  // share before the last step
};

}  // namespace robostress::piper
