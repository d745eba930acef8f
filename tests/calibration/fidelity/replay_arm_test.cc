#include "calibration/fidelity/replay_arm.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;

constexpr int kLayout = 40;

ReplayTask Task(GoalReference reference) {
  ReplayTask task;
  task.sim.goal_reference = reference;
  return task;
}

Scenario Clean() { return MakeScenario("clean", 5).value(); }

TEST(ReplayArm, ReplaysWhatItRecorded) {
  for (const GoalReference reference : {GoalReference::kDesired, GoalReference::kAchieved}) {
    const auto arm = ReplayArm::Create(Task(reference), 0).value();
    const Demonstration demonstration = arm->Record(kLayout, Clean()).value();
    const Replay first = arm->Run(kLayout, demonstration, {.scenario = Clean()}).value();
    const Replay second = arm->Run(kLayout, demonstration, {.scenario = Clean()}).value();
    ASSERT_EQ(first.p.size(), demonstration.targets.size() + 1);
    EXPECT_TRUE(FindGrasp(first).ok());
    for (size_t i = 0; i < first.p.size(); ++i) EXPECT_EQ(first.p[i], second.p[i]);
  }
}

TEST(ReplayArm, SagsUnderAMassThatTheControllerDoesNotKnow) {
  const auto light = ReplayArm::Create(Task(GoalReference::kDesired), 0).value();
  const auto heavy = ReplayArm::Create(Task(GoalReference::kDesired), 1).value();
  const Demonstration demonstration = light->Record(kLayout, Clean()).value();
  const Replay unloaded = light->Run(kLayout, demonstration, {.scenario = Clean()}).value();
  const Replay loaded = heavy->Run(kLayout, demonstration, {.scenario = Clean()}).value();
  const GraspSpan span = FindGrasp(unloaded).value();
  ASSERT_TRUE(FindGrasp(loaded).ok());
  const auto a = AtPhases(loaded, span), b = AtPhases(unloaded, span);
  EXPECT_LT((a[20] - b[20]).norm(), 1e-6);  // on the way there the payload is on the table
  // Static balance of the controller: m g = Lambda kp dz with an operational inertia of a few kg.
  const double sag = (b[80] - a[80]).z();
  EXPECT_GT(sag, 2e-3);
  EXPECT_LT(sag, 20e-3);
}

TEST(ReplayArm, DeviatesInProportionToTheNoise) {
  const auto arm = ReplayArm::Create(Task(GoalReference::kDesired), 0).value();
  const Demonstration demonstration = arm->Record(kLayout, Clean()).value();
  const Replay none = arm->Run(kLayout, demonstration, {.scenario = Clean()}).value();
  const auto deviation = [&](double sigma) {
    const Replay replay =
        arm->Run(kLayout, demonstration, {.scenario = Clean(), .command_sigma = sigma}).value();
    return (replay.p[25] - none.p[25]).norm();
  };
  const double small = deviation(1e-3);
  EXPECT_GT(small, 0);
  EXPECT_NEAR(deviation(4e-3) / small, 4, 0.2);
}

TEST(ReplayArm, RefusesTasksWithoutAnObjectToPlaceAndBadPayloads) {
  ReplayTask task;
  task.suite = "tabletop_nowhere";
  EXPECT_THAT(std::string(ReplayArm::Create(task, 0).status().message()),
              HasSubstr("tabletop_nowhere"));
  task = ReplayTask();
  task.task = 99;
  EXPECT_THAT(std::string(ReplayArm::Create(task, 0).status().message()), HasSubstr("0 to 9"));
  EXPECT_THAT(std::string(ReplayArm::Create(ReplayTask(), -1).status().message()),
              HasSubstr("-1 kg"));
  task.task = 0, task.suite = "tabletop_long";
  EXPECT_THAT(std::string(ReplayArm::Create(task, 0).status().message()),
              HasSubstr("not to pick up and place one object"));
}

}  // namespace
}  // namespace robostress::calibration
