#pragma once

#include <Eigen/Core>
#include <functional>

#include "robot_client/control/live_target.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/snapshot_cell.h"

namespace robostress {

// What a person holds down now, as shares of the configured speeds, -1 .. 1.
struct JogInput {
  int64_t stamp_ns = 0;   // of the last sign that it is still held, on the client's clock
  bool gone = false;      // the device was unplugged, the terminal closed
  bool by_joint = false;  // `joint` moves at tool[0] of its speed, and the tool as it follows
  int joint = 0;          // 0 .. 5
  double tool[6] = {};    // base frame: x, y, z, then turns about the axes x, y, z
  double gripper = 0;     // positive opens
};

struct JogOptions {
  double tool_velocity = 0.1;      // [m/s]
  double turn_velocity = 0.5;      // [rad/s]
  double joint_velocity = 0.2;     // [rad/s] of a joint that is moved alone
  double fastest_joint = 0.6;      // [rad/s] that the tool's motion may ask for
  double gripper_velocity = 0.05;  // [m/s]
  double dead_man_s = 0.25;        // a key or a stick that was not confirmed for so long is let go
  double joint_margin = 0.02;      // [rad] kept from the arm's limits, as the limiter keeps it
  double period_s = 1.0 / 30;
};

// (v, w) = J dq of the tool at joints q, base frame [m/s, rad/s]. Allocates nothing.
using ToolJacobianOf = std::function<Eigen::Matrix<double, 6, piper::kJoints>(const ArmVector&)>;

// Targets of a person who jogs: the tool moves along and about the base frame's axes, or a joint
// moves alone, while a key or the dead man's button is held.
//
// Joint velocities are those of damped least squares by singular values s_i (u_i, v_i) of J, turns
// weighted with 0.1 m: dq = sum s_i / (s_i^2 + l_i^2) (u_i . x) v_i, where l_i^2 = kMost^2 (1 -
// (s_i / kNear)^2) below kNear and 0 above (after Chiaverini, Siciliano and Egeland, IEEE Trans.
// Control Systems Tech. 2, 1994): away from singularities the motion is exact, in one the arm
// slows down. What still asks for a faster joint than fastest_joint is slowed down as a whole. A
// joint at its limit is left out and the others do what they can. Control thread.
class JogTarget : public LiveTarget {
 public:
  // `input` outlives it.
  JogTarget(const SnapshotCell<JogInput>* input, ToolJacobianOf jacobian, const ArmLimits& limits,
            const JogOptions& options)
      : input_(input), jacobian_(std::move(jacobian)), limits_(limits), options_(options) {}

  void Begin(const ArmVector& command) override { target_ = command; }
  bool Silent(int64_t) const override { return input_->Load().gone; }
  LiveRow Next(int64_t now_ns, const ArmVector& command) override;

 private:
  using Vector6 = Eigen::Matrix<double, piper::kJoints, 1>;
  Vector6 JointVelocity(const JogInput& input) const;

  const SnapshotCell<JogInput>* const input_;
  const ToolJacobianOf jacobian_;
  const ArmLimits limits_;
  const JogOptions options_;
  ArmVector target_{};
};

}  // namespace robostress
