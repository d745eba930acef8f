#include "adapter/nominal_arm.h"

#include <gtest/gtest.h>

#include <cmath>

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

TEST(NominalArm, ContinuesFromASavedState) {
  NominalArm a({}), b({});
  a.Step(Vector6::Constant(0.7));
  b.set_state(a.state());
  EXPECT_EQ(a.Step(Vector6::Constant(-0.2)), b.Step(Vector6::Constant(-0.2)));
}

}  // namespace
}  // namespace robostress
