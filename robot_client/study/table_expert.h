#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/robot_arm.h"
#include "robot_client/study/table_scene.h"

namespace robostress::piper {

// What the expert commands in a tick, and what it looks at.
struct ExpertDecision {
  ArmVector target{};      // absolute joints [rad], opening [m]
  Eigen::Vector3d object;  // what the fingers go for, base frame [m]
  Eigen::Vector3d destination;
  bool holding = false;
  double progress = 0;  // 0 .. 1
};

// Teleoperation, scripted: moves a reference of the finger tips over the table, slowly near its
// goals, and answers with the joints that bring the tips there. The phase (reach, close, carry, let
// go, pull) follows from the state of the table alone; only the reference has a memory, as the
// leader arm of a person has. The gripper keeps one attitude: pitched kTilt forward from straight
// down, opening across the arm's own vertical plane, which a Piper holds all over the table.
class TableExpert {
 public:
  static constexpr double kTilt = 30 * M_PI / 180;
  static constexpr double kSpeed = 0.2;  // [m/s]

  explicit TableExpert(const TableScene* scene) : scene_(scene) {}

  // The pose that episodes start from, gripper open.
  static absl::StatusOr<ArmVector> Home();

  // The arm stands at `joints` [rad] and follows its targets from there.
  void Start(const ArmVector& joints);
  // One control step of `dt` [s]. FAILED_PRECONDITION where the arm cannot reach.
  absl::StatusOr<ExpertDecision> Next(double dt);
  // The joints whose tips are displaced from the decision's by `offset` [m]: a hand that trembles.
  absl::StatusOr<ArmVector> Displaced(const ExpertDecision& decision,
                                      const Eigen::Vector3d& offset) const;

 private:
  struct Goal {
    Eigen::Vector3d tips;
    double opening;
  };
  Goal Decide(const TableState& state, ExpertDecision& decision);
  Goal CarryBowl(const TableState& state, ExpertDecision& decision);
  Goal PullDrawer(const TableState& state, ExpertDecision& decision);
  Eigen::Vector3d Funnel(const Eigen::Vector3d& goal, double clearance) const;

  const TableScene* scene_;
  JointVector joints_{};
  Eigen::Vector3d tips_ = Eigen::Vector3d::Zero(), velocity_ = Eigen::Vector3d::Zero();
};

}  // namespace robostress::piper
