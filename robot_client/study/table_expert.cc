#include "robot_client/study/table_expert.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "common/status_macros.h"
#include "robot_client/emulator/other_modes.h"

namespace robostress::piper {
namespace {

using Eigen::Vector3d;

constexpr double kTips = 0.1358;       // before the tool frame (piper_mjcf.cc) [m]
constexpr double kAcceleration = 0.8;  // of the reference [m/s^2]
constexpr double kApproach = 4;        // speed over distance near a goal [1/s]
constexpr double kNear = 0.012;        // [m]
constexpr double kFunnelWidth = 0.012, kFunnelSlope = 2;
constexpr double kReachClearance = 0.06, kCarryClearance = 0.07;  // [m]
constexpr double kGraspHeight = 0.018;                            // tips above the bowl's underside
constexpr double kHandleHeight = -0.008;                          // tips from the handle's middle
constexpr double kReleaseHeight = 0.008;                          // of the bowl above the plate
constexpr double kOpen = kGripperOpening, kShut = 0;
constexpr double kRim = kBowlRadius - kBowlWall / 2;
constexpr double kHeldBowl = 0.012,
                 kHeldHandle = 0.022;  // less between the fingers: something held
constexpr double kClosed = 0.003;      // nothing between them
const Vector3d kHomeTips(0.27, 0, 0.2);
// A bent elbow, from which every pose over the table is found.
constexpr JointVector kBent = {0, 1.5, -1.2, 0, 0.8, 0};

Vector3d Across(const Vector3d& p) { return Vector3d(-p.y(), p.x(), 0).normalized(); }

absl::StatusOr<JointVector> JointsOf(const Vector3d& tips, const JointVector& near) {
  const Eigen::Matrix3d R = (Eigen::AngleAxisd(std::atan2(tips.y(), tips.x()), Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(M_PI - TableExpert::kTilt, Vector3d::UnitY()))
                                .toRotationMatrix();
  const Vector3d tool = tips - kTips * R.col(2);
  const auto joints = SolvePose(tool, FixedAngles(R), near, kJointRanges, Zero::kSince_1_6_3);
  if (joints) return *joints;
  return absl::FailedPreconditionError(absl::StrFormat(
      "the arm cannot hold its finger tips at (%.3f, %.3f, %.3f) m", tips.x(), tips.y(), tips.z()));
}

}  // namespace

absl::StatusOr<ArmVector> TableExpert::Home() {
  RS_ASSIGN_OR_RETURN(const JointVector joints, JointsOf(kHomeTips, kBent));
  ArmVector home{};
  std::copy(joints.begin(), joints.end(), home.begin());
  home[kJoints] = kOpen;
  return home;
}

void TableExpert::Start(const ArmVector& joints) {
  std::copy_n(joints.begin(), kJoints, joints_.begin());
  const Eigen::Isometry3d T = ToolPose(joints_, Zero::kSince_1_6_3);
  tips_ = T * Vector3d(0, 0, kTips);
  velocity_.setZero();
}

// Down to a goal from above: the further beside it, the higher.
Vector3d TableExpert::Funnel(const Vector3d& goal, double clearance) const {
  const double beside = (goal - tips_).head<2>().norm();
  const double up = std::min(clearance, std::max(0.0, beside - kFunnelWidth) * kFunnelSlope);
  Vector3d way = goal + Vector3d(0, 0, up);
  // Too low for where it is: up first.
  const double below = way.z() - tips_.z();
  if (below > 0.02) way.head<2>() = tips_.head<2>() + 0.15 * (way - tips_).head<2>();
  return way;
}

TableExpert::Goal TableExpert::CarryBowl(const TableState& state, ExpertDecision& decision) {
  decision.object = state.bowl;
  decision.destination = state.plate;
  const Vector3d rim = state.bowl + kRim * Across(state.bowl);
  const bool at_rim =
      (state.grip - rim).head<2>().norm() < 0.03 && state.grip.z() - state.bowl.z() < kBowlHeight;
  decision.holding = at_rim && state.opening < kHeldBowl && state.opening > kClosed;
  const Vector3d place = state.plate + kRim * Across(state.plate) +
                         Vector3d(0, 0, kPlateHeight + kReleaseHeight + kGraspHeight);
  const double beside = (state.bowl - state.plate).head<2>().norm();
  if (decision.holding) {
    const bool there = (tips_ - place).norm() < 0.006 && (state.grip - place).norm() < 0.02;
    decision.progress = 0.5 + 0.4 * std::exp(-beside / 0.15);
    return {Funnel(place, std::max(kCarryClearance, state.bowl.z() > 0.08 ? 0.09 : 0.0)),
            there ? kOpen : kShut};
  }
  const bool on_plate = beside < 0.045 && state.bowl.z() < state.plate.z() + 0.03;
  if (on_plate) {  // let go, then up
    decision.progress = state.opening > 0.05 ? 1 : 0.92;
    Vector3d up = tips_;
    if (state.opening > 0.05) up.z() = std::max(up.z(), 0.16);
    return {up, kOpen};
  }
  const Vector3d grasp = rim + Vector3d(0, 0, kGraspHeight);
  const bool closing = state.opening < 0.05;
  const double slack = closing ? 2 : 1;
  const Vector3d error = (state.grip - grasp).cwiseAbs();
  if (error.head<2>().norm() < slack * kNear && error.z() < slack * kNear &&
      state.opening > kClosed) {
    decision.progress = 0.45;
    return {grasp, kShut};
  }
  decision.progress = 0.4 * std::exp(-(state.grip - grasp).norm() / 0.15);
  return {Funnel(grasp, kReachClearance), kOpen};
}

TableExpert::Goal TableExpert::PullDrawer(const TableState& state, ExpertDecision& decision) {
  const Vector3d grasp = state.handle + Vector3d(0, 0, kHandleHeight);
  decision.object = state.handle;
  decision.destination = state.handle - Vector3d(kDrawerTravel - state.drawer, 0, 0);
  const Vector3d error = (state.grip - grasp).cwiseAbs();
  const bool around = error.x() < 0.02 && error.y() < 0.02 && error.z() < 0.02;
  decision.holding = around && state.opening < kHeldHandle && state.opening > kClosed;
  if (decision.holding) {
    decision.progress = 0.5 + 0.5 * std::min(1.0, state.drawer / TableScene::kDrawerOpen);
    return {Vector3d(tips_.x() - 0.05, grasp.y(), grasp.z()), kShut};
  }
  const bool closing = state.opening < 0.05;
  const double slack = closing ? 1.6 : 1;
  if (error.x() < slack * kNear && error.y() < slack * kNear && error.z() < slack * kNear &&
      state.opening > kClosed) {
    decision.progress = 0.45;
    return {grasp, kShut};
  }
  decision.progress = 0.4 * std::exp(-(state.grip - grasp).norm() / 0.15);
  return {Funnel(grasp, kReachClearance), kOpen};
}

TableExpert::Goal TableExpert::Decide(const TableState& state, ExpertDecision& decision) {
  return scene_->task().kind == TableTaskKind::kOpenDrawer ? PullDrawer(state, decision)
                                                           : CarryBowl(state, decision);
}

absl::StatusOr<ExpertDecision> TableExpert::Next(double dt) {
  ExpertDecision decision;
  const Goal goal = Decide(scene_->Look(), decision);
  const Vector3d way = goal.tips - tips_;
  const double distance = way.norm();
  const Vector3d wanted = distance > 1e-9
                              ? Vector3d(way / distance * std::min(kSpeed, kApproach * distance))
                              : Vector3d::Zero();
  const Vector3d change = wanted - velocity_;
  velocity_ += change * std::min(1.0, kAcceleration * dt / (change.norm() + 1e-12));
  tips_ += velocity_ * dt;
  RS_ASSIGN_OR_RETURN(joints_, JointsOf(tips_, joints_));
  std::copy(joints_.begin(), joints_.end(), decision.target.begin());
  decision.target[kJoints] = goal.opening;
  return decision;
}

absl::StatusOr<ArmVector> TableExpert::Displaced(const ExpertDecision& decision,
                                                 const Vector3d& offset) const {
  RS_ASSIGN_OR_RETURN(const JointVector joints, JointsOf(tips_ + offset, joints_));
  ArmVector target = decision.target;
  std::copy(joints.begin(), joints.end(), target.begin());
  return target;
}

}  // namespace robostress::piper
