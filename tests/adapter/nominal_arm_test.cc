#include "adapter/nominal_arm.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>

#include "adapter/panda_dynamics.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;

TEST(NominalArm, ApproachesTheSteadyGainOfAGoalThatIsRebasedOnTheAchievedPose) {
  // One-dimensional integration of the same law outside this code: 0.132, 0.239, 0.261, 0.266,
  // 0.267.
  NominalArm arm({});
  const double expected[] = {0.132, 0.239, 0.261, 0.266, 0.267};
  for (const double gain : expected) {
    const Vector6 delta = arm.Step(Vector6::Constant(0.5));
    EXPECT_NEAR(delta[0] / 0.5, gain, 0.0015);
    EXPECT_EQ(delta[0], delta[5]);
  }
}

TEST(NominalArm, DeliversTheWholeCommandWhenTheGoalIsRebasedOnThePreviousGoal) {
  NominalArmOptions options;
  options.goal_reference = GoalReference::kDesired;
  NominalArm arm(options);
  double total = 0;
  for (int i = 0; i < 40; ++i) total += arm.Step(Vector6::Constant(0.1))[2];
  for (int i = 0; i < 40; ++i) total += arm.Step(Vector6::Zero())[2];
  EXPECT_NEAR(total, 4.0, 1e-6);
}

TEST(NominalArm, IsCriticallyDamped) {
  // x(t) = 1 - (1 + w t) exp(-w t) for a unit step held for one period, w = sqrt(150).
  NominalArmOptions options;
  options.sub_steps = 25000;  // the closed form is the limit of small steps
  NominalArm arm(options);
  const double w = std::sqrt(150.0), t = 0.05;
  EXPECT_NEAR(arm.Step(Vector6::Ones())[1], 1 - (1 + w * t) * std::exp(-w * t), 1e-4);
}

TEST(NominalArm, ClipsAsTheControllerDoes) {
  NominalArm a({}), b({});
  EXPECT_EQ(a.Step(Vector6::Constant(7)), b.Step(Vector6::Ones()));
}

TEST(NominalArm, CarriesItsVelocityAndForgetsItOnReset) {
  NominalArm arm({});
  const Vector6 first = arm.Step(Vector6::Ones());
  EXPECT_GT(arm.Step(Vector6::Ones())[0], first[0]);
  arm.Reset();
  EXPECT_EQ(arm.Step(Vector6::Ones()), first);
}

TEST(NominalArm, KeepsItsRotationGoalWhenNoRotationIsCommanded) {
  NominalArm arm({});
  Vector6 turn = Vector6::Zero();
  turn[4] = 1;
  double total = arm.Step(turn)[4];
  for (int i = 0; i < 60; ++i) total += arm.Step(Vector6::Zero())[4];
  EXPECT_NEAR(total, 1.0, 1e-6);  // the whole turn is made, late
}

TEST(NominalArm, APandaStartsAlongItsCoupling) {
  NominalArmOptions options;
  options.panda_dynamics = true;
  options.sub_steps = 1;  // x = h^2 C kp a
  for (int axis = 0; axis < 6; ++axis) {
    NominalArm arm(options);
    const Vector6 moved = arm.Step(0.4 * Vector6::Unit(axis));
    const Vector6 expected = 0.05 * 0.05 * 150 * 0.4 * PandaDynamics::At({}, {}).coupling.col(axis);
    EXPECT_LT((moved - expected).norm(), 1e-12) << axis;
  }
}

// Eigenvalues in [0, 2]: whatever the posture, it is damped as the uncoupled one or better than
// half as well. Positions of no Panda, and of a singular one, count as those of the home posture.
TEST(PandaDynamics, IsDefinedInAnyPosture) {
  const Eigen::Matrix<double, 6, 6> home = PandaDynamics::At({}, {}).coupling;
  srand(7);
  for (int i = 0; i < 200; ++i) {
    const Eigen::VectorXd q = 2 * Eigen::VectorXd::Random(7);
    const Eigen::VectorXcd values = PandaDynamics::At(q, {}).coupling.eigenvalues();
    EXPECT_LT(values.imag().cwiseAbs().maxCoeff(), 1e-6);
    EXPECT_GE(values.real().minCoeff(), -1e-6);
    EXPECT_LE(values.real().maxCoeff(), 2 + 1e-6);
  }
  EXPECT_EQ(PandaDynamics::At(Eigen::VectorXd::Zero(6), {}).coupling, home);
  EXPECT_EQ(PandaDynamics::At(Eigen::VectorXd::Constant(7, NAN), {}).coupling, home);
  EXPECT_TRUE(PandaDynamics::At(Eigen::VectorXd::Zero(7), {}).coupling.allFinite());
}

TEST(NominalArm, APandasDriftIsAnAcceleration) {
  RobotState before;
  before.q = Eigen::VectorXd::Constant(7, 0.5);
  before.dq = Eigen::VectorXd::Unit(7, 0);
  NominalArmOptions options;
  options.panda_dynamics = true;
  options.sub_steps = 1;  // x = h^2 d
  const Vector6 drift = PandaDynamics::At(before.q, before.dq).drift;
  EXPECT_GT(drift.head<3>().norm(), 1);
  EXPECT_LT((NominalArm(options).Step(Vector6::Zero(), before) - 0.05 * 0.05 * drift).norm(),
            1e-12);
  options.panda_dynamics = false;
  EXPECT_EQ(NominalArm(options).Step(Vector6::Zero(), before), Vector6::Zero());
}

// It shifts while it turns; what it was told, it does.
TEST(NominalArm, APandaGetsToTheSameGoal) {
  NominalArmOptions options;
  options.goal_reference = GoalReference::kDesired;
  options.panda_dynamics = true;
  NominalArm arm(options);
  const Vector6 turn = 0.5 * Vector6::Unit(4);
  Vector6 moved = arm.Step(turn);
  EXPECT_LT(moved[0], -0.1);
  for (int i = 0; i < 200; ++i) moved += arm.Step(Vector6::Zero());
  EXPECT_LT((moved - turn).norm(), 1e-6);
}

TEST(NominalArm, ContinuesFromASavedState) {
  NominalArm a({}), b({});
  a.Step(Vector6::Constant(0.7));
  b.set_state(a.state());
  EXPECT_EQ(a.Step(Vector6::Constant(-0.2)), b.Step(Vector6::Constant(-0.2)));
}

}  // namespace
}  // namespace robostress
