#include "sim_worker/osc_controller.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

namespace robostress {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

// Six joints that are the tool's six directions and a seventh that moves nothing; every joint has
// the inertia `inertia`.
ArmState Arm(double inertia) {
  ArmState arm;
  arm.q.setZero();
  arm.dq.setZero();
  arm.p_tool = {0.4, 0.1, 0.3};
  arm.R_tool = Eigen::Matrix3d::Identity();
  arm.J.setZero();
  arm.J.leftCols<6>().setIdentity();
  arm.M = inertia * Matrix7d::Identity();
  return arm;
}

Vector6d Command(double x, double rotation_z) {
  Vector6d command = Vector6d::Zero();
  command[0] = x;
  command[5] = rotation_z;
  return command;
}

TEST(OscController, ForceIsInertiaTimesTheGainTimesTheWayToTheGoal) {
  const Vector7d bias = Vector7d::LinSpaced(1, 7);
  for (const double inertia : {1.0, 2.5}) {
    const ArmState arm = Arm(inertia);
    OscController controller(GoalReference::kAchieved);
    controller.Reset(arm, arm.q);
    EXPECT_LT((controller.Torque(arm, bias) - bias).norm(), 1e-12) << "at rest at its goal";
    controller.SetGoal(Command(0.5, 0.4), arm);
    Vector7d expected = bias;
    expected[0] += inertia * 150 * 0.05 * 0.5;
    expected[5] += inertia * 150 * std::sin(0.5 * 0.4);
    EXPECT_LT((controller.Torque(arm, bias) - expected).norm(), 1e-9);
  }
}

TEST(OscController, AStifferOneIsDampedCriticallyToo) {
  ArmState arm = Arm(2);
  OscController controller(GoalReference::kAchieved, false, 600);
  controller.Reset(arm, arm.q);
  controller.SetGoal(Command(0.5, 0), arm);
  arm.dq[0] = 0.3;
  EXPECT_NEAR(controller.Torque(arm, Vector7d::Zero())[0],
              2 * (600 * 0.05 * 0.5 - 2 * std::sqrt(600.0) * 0.3), 1e-9);
}

TEST(OscController, DampsCritically) {
  ArmState arm = Arm(2);
  OscController controller(GoalReference::kAchieved);
  controller.Reset(arm, arm.q);
  arm.dq[1] = 0.3;
  arm.dq[4] = -0.2;
  Vector7d expected = Vector7d::Zero();
  expected[1] = -2 * 2 * std::sqrt(150.0) * 0.3;
  expected[4] = 2 * 2 * std::sqrt(150.0) * 0.2;
  EXPECT_LT((controller.Torque(arm, Vector7d::Zero()) - expected).norm(), 1e-9);
}

TEST(OscController, ThePostureMovesWhatMovesNoTool) {
  ArmState arm = Arm(2);
  OscController controller(GoalReference::kAchieved);
  const Vector7d home = Vector7d::Constant(0.1);
  controller.Reset(arm, home);
  arm.dq[6] = 0.5;
  Vector7d expected = Vector7d::Zero();
  expected[6] = 2 * (10 * 0.1 - 2 * std::sqrt(10.0) * 0.5);
  EXPECT_LT((controller.Torque(arm, Vector7d::Zero()) - expected).norm(), 1e-9);
}

TEST(OscController, AGoalStartsFromWhereTheArmIsOrFromTheLastGoal) {
  const ArmState arm = Arm(1);
  for (const bool achieved : {true, false}) {
    OscController controller(achieved ? GoalReference::kAchieved : GoalReference::kDesired);
    controller.Reset(arm, arm.q);
    for (int i = 0; i < 3; ++i) controller.SetGoal(Command(1, 0.2), arm);
    const int steps = achieved ? 1 : 3;
    EXPECT_NEAR(controller.goal_position().x(), 0.4 + steps * 0.05, 1e-12);
    EXPECT_NEAR(Eigen::AngleAxisd(controller.goal_rotation()).angle(), steps * 0.1, 1e-12);
  }
}

}  // namespace
}  // namespace robostress
