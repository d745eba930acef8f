// Pressing against something, giving way, and the bounds of the workspace.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/robot_client/control/client_bench.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// Torques of nothing, and a wall at J1 = `wall`.
struct WallModel : ArmModel {
  ArmVector Torque(const ArmVector&, const ArmVector&, const ArmVector&,
                   double payload_kg) const override {
    ArmVector torque{};
    torque[1] = 10 * payload_kg;
    return torque;
  }
  Clearance ClearanceAt(const ArmVector& position) const override {
    return {wall - position[0], 1, 1};
  }
  double wall = 10;
};

TEST(ControlLoopBoundsTest, TorqueBeyondTheModelIsHeldWithinTenthsAndTheCommandGoesBack) {
  WallModel model;
  ClientBench bench({}, &model);
  bench.policy_speed = 0.9;
  bench.Start();
  bench.Ticks(10);
  bench.arm.blocked = true;
  bench.arm.effort[1] = 10.9;  // 5 Nm a payload explains, 6 are allowed
  bench.Ticks(10);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  bench.arm.effort[1] = 11.1;
  int ticks = 1;
  for (; bench.Tick().state == ClientState::kRun; ++ticks) ASSERT_LT(ticks, 10);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kPressing);
  EXPECT_LE(ticks, 3) << "0.1 s";
  EXPECT_NEAR(bench.seen.back().excess[1], 6.1, 1e-9);
  bench.Ticks(90);
  for (int j = 0; j < ArmAxes().joints; ++j) {
    EXPECT_NEAR(bench.arm.last.position[j], bench.seen.back().position[j] - (j <= 1 ? 0.02 : 0),
                1e-3)
        << "J1 and J2 give way to what they press against";
  }
  bench.arm.effort[1] = 60;
  ClientBench sudden({}, &model);
  sudden.Start();
  sudden.Ticks(5);
  sudden.arm.effort[1] = 17.1;
  EXPECT_EQ(sudden.Tick().state, ClientState::kHold) << "twice as much at once";
}

TEST(ControlLoopBoundsTest, AnArmThatGivesWayDoesNotDoSoForEver) {
  WallModel model;
  ClientBench bench({}, &model);
  bench.Tick(kRequestEnable);
  const double stood = bench.arm.Latest().position[1];
  bench.arm.effort[1] = 30;  // a weight that nobody declared
  bench.Ticks(300);
  EXPECT_NEAR(bench.arm.last.position[1], stood - 0.2, 1e-6);
}

TEST(ControlLoopBoundsTest, ABlockedJointIsHeldThoughEachChunkBeginsWhereItStands) {
  ClientBench bench;  // no model: an arm without torques
  bench.policy_speed = 0.6;
  bench.Start();
  bench.Ticks(25);
  bench.arm.blocked = true;
  int ticks = 0;
  while (bench.Tick().state == ClientState::kRun && ticks < 100) ++ticks;
  EXPECT_EQ(bench.seen.back().cause, StateCause::kBlocked);
  EXPECT_LE(ticks, 40);
  double worst = 0;
  for (const TickRecord& r : bench.seen)
    worst = std::max(worst, std::abs(r.sent[0] - r.position[0]));
  EXPECT_LT(worst, 0.35) << "the following error alone would not have seen it";
}

TEST(ControlLoopBoundsTest, NoCommandAndNoBrakingCrossesABoundOfTheWorkspace) {
  WallModel model;
  model.wall = 0.45;
  ClientBench bench({}, &model);
  bench.policy_speed = 1.4;
  bench.Start();
  for (int i = 0; i < 120 && bench.loop->state() == ClientState::kRun; ++i) bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kWorkspace);
  EXPECT_EQ(bench.loop->crossed(), ArmModel::kTable);
  double furthest = 0;
  for (const TickRecord& r : bench.seen) furthest = std::max(furthest, r.sent[0]);
  EXPECT_LE(furthest, model.wall);
  EXPECT_GT(furthest, model.wall - 0.1) << "it goes up to it";
  bench.Ticks(20);
  bench.policy_speed = -0.6;
  bench.Tick(kRequestResume);
  bench.Ticks(60);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun)
      << CauseName(bench.loop->cause()) << ": away from it is free";
  EXPECT_LT(bench.seen.back().sent[0], furthest - 0.2);
}

// What of the way to rest is not looked at may cross a bound.
TEST(ControlLoopBoundsTest, AnArmThatBrakesForLongerThanIsLookedAheadIsRefused) {
  WallModel model;
  ManualClock clock{1'000'000'000};
  FakeArm arm(&clock);
  FakeStamps cameras;
  ASSERT_TRUE(arm.Connect().ok());
  ControlOptions options;
  const auto create = [&](const ArmModel* known) {
    return ControlLoop::Create(options, &arm, &clock, &cameras, known).status();
  };
  options.rate_hz = 200;
  EXPECT_TRUE(create(&model).ok());
  options.limits.joint_velocity = 3;
  const absl::Status refused = create(&model);
  EXPECT_TRUE(absl::IsInvalidArgument(refused));
  EXPECT_THAT(std::string(refused.message()),
              ::testing::AllOf(HasSubstr("joint_velocity is 3 rad/s, joint_acceleration 5 rad/s^2"),
                               HasSubstr("control.rate_hz 200: J1 brakes for up to 16"),
                               HasSubstr("looked for in 100; lower the velocity")));
  EXPECT_TRUE(create(nullptr).ok()) << "nothing is looked for";
  options.workspace.guard = false;
  EXPECT_TRUE(create(&model).ok());
  options.workspace.guard = true;
  options.rate_hz = 100;
  EXPECT_TRUE(create(&model).ok());
  options.limits.gripper_acceleration = 0.1;
  EXPECT_THAT(std::string(create(&model).message()), HasSubstr("gripper_acceleration 0.1"));
}

TEST(ControlLoopBoundsTest, APolicyRunsOnlyInsideTheWorkspace) {
  WallModel model;
  model.wall = -0.05;  // the arm stands 50 mm into it
  ClientBench bench({}, &model);
  bench.Tick(kRequestEnable);
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kOutside);
  EXPECT_EQ(bench.loop->crossed(), ArmModel::kTable);
  EXPECT_NEAR(bench.loop->outside_m(), 0.05, 1e-9);
  ArmPath out;
  for (int i = 1; i <= 60; ++i) {
    out.rows.push_back(bench.arm.Latest().position);
    out.rows.back()[0] = -0.2 * i / 60;
  }
  bench.loop->Play(&out);
  for (int i = 0; i < 150 && bench.loop->cause() != StateCause::kArrived; ++i) bench.Tick();
  ASSERT_EQ(bench.loop->cause(), StateCause::kArrived) << "a way of the client's own leads out";
  bench.Ticks(10);
  bench.Tick(kRequestStart);
  ASSERT_EQ(bench.loop->state(), ClientState::kRun);
  bench.Tick(kRequestHold);
  bench.Ticks(20);
  model.wall = -0.3;
  bench.Tick(kRequestResume);
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kOutside);
  model.wall = 10;
  bench.Tick(kRequestResume);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kNone);
}

}  // namespace
}  // namespace robostress
