// What makes the client hold, stop or fault, and what it takes to go on.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <string>

#include "tests/robot_client/control/client_bench.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// Cause by cause: what happens in mid-motion, which state follows, and how long the command moves.
struct Mishap {
  const char* name;
  void (*happen)(ClientBench&);
  ClientState state;
  StateCause cause;
  int within_ticks;
};
class ControlLoopMishapTest : public ::testing::TestWithParam<Mishap> {};

TEST_P(ControlLoopMishapTest, TheArmHoldsInTime) {
  const Mishap& mishap = GetParam();
  ClientBench bench;
  bench.policy_speed = 0.6;
  bench.Start();
  bench.Ticks(25);
  ASSERT_GT(std::abs(bench.seen.back().sent[0] - bench.seen[bench.seen.size() - 2].sent[0]), 0.01);
  mishap.happen(bench);
  int ticks = 0;
  while (bench.Tick().state != mishap.state && ticks < 200) ++ticks;
  EXPECT_EQ(bench.loop->state(), mishap.state);
  EXPECT_EQ(bench.seen.back().cause, mishap.cause);
  EXPECT_LE(ticks, mishap.within_ticks);
  const int sends = bench.arm.sends;
  bench.Ticks(40);  // 1 rad/s is gone after 9; then the command goes back to where the arm stands
  const ArmVector rest = bench.arm.last.position;
  bench.Ticks(100);
  EXPECT_EQ(bench.arm.last.position, rest) << "it does not move any more";
  if (mishap.state == ClientState::kFault) {
    EXPECT_EQ(bench.arm.sends, sends) << "a fault sends nothing";
  }
  EXPECT_EQ(bench.arm.enables, 1) << "nothing enables it again";
  EXPECT_EQ(bench.arm.disables, 0) << "nothing drops it";
}

INSTANTIATE_TEST_SUITE_P(
    Causes, ControlLoopMishapTest,
    ::testing::Values(Mishap{"server_killed", [](ClientBench& b) { b.server_alive = false; },
                             ClientState::kHold, StateCause::kServerSilent, 82},
                      Mishap{"camera_unplugged", [](ClientBench& b) { b.camera_alive = false; },
                             ClientState::kHold, StateCause::kCameraStale, 15},
                      Mishap{"arm_silent", [](ClientBench& b) { b.arm.silent = true; },
                             ClientState::kHold, StateCause::kArmSilent, 2},
                      Mishap{"arm_silent_for_long", [](ClientBench& b) { b.arm.silent = true; },
                             ClientState::kFault, StateCause::kArmSilent, 8},
                      Mishap{"arm_fault", [](ClientBench& b) { b.arm.faults = kFaultCollision; },
                             ClientState::kFault, StateCause::kArmFault, 0},
                      Mishap{"enable_lost", [](ClientBench& b) { b.arm.lost_enable = true; },
                             ClientState::kFault, StateCause::kArmDisabled, 0},
                      Mishap{"bus_off", [](ClientBench& b) { b.arm.refuse_send = true; },
                             ClientState::kHold, StateCause::kSendFailed, 3},
                      Mishap{"blocked",
                             [](ClientBench& b) {
                               b.arm.blocked = true;
                               b.policy_speed = 2;
                               b.policy_offset = 0.4;
                             },
                             ClientState::kHold, StateCause::kBlocked, 60},
                      Mishap{"operator", [](ClientBench& b) { b.loop->Ask(kRequestHold); },
                             ClientState::kHold, StateCause::kOperator, 0}),
    [](const auto& info) { return std::string(info.param.name); });

TEST(ControlLoopStopsTest, TheSecondStageOfAStopRepeatsTheDampedStop) {
  ClientBench bench;
  bench.Start();
  bench.Ticks(20);
  bench.Tick(kRequestHold);
  EXPECT_EQ(bench.arm.quick_stops, 0);
  bench.Tick(kRequestQuickStop);
  const int sends = bench.arm.sends;
  bench.Ticks(10);
  EXPECT_EQ(bench.arm.quick_stops, 11);
  EXPECT_EQ(bench.arm.sends, sends);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kQuickStop);
}

TEST(ControlLoopStopsTest, APressHoldsAndASecondOneSoonAfterIsTheQuickStop) {
  ClientBench bench;
  std::atomic<int> presses{0};
  bench.loop->ObeyStops(&presses);
  bench.Start();
  bench.Ticks(10);
  ++presses;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  bench.Ticks(95);  // more than three seconds
  bench.Tick(kRequestResume);
  bench.Ticks(10);
  ++presses;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold) << "a first press again";
  bench.Ticks(20);
  EXPECT_EQ(bench.arm.quick_stops, 0);
  ++presses;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  EXPECT_EQ(bench.arm.quick_stops, 1);
}

TEST(ControlLoopStopsTest, TwoPressesBetweenTwoTicksAreTheQuickStop) {
  ClientBench bench;
  std::atomic<int> presses{0};
  bench.loop->ObeyStops(&presses);
  bench.Start();
  presses += 2;
  bench.Tick();
  EXPECT_EQ(bench.seen.back().cause, StateCause::kQuickStop);
}

TEST(ControlLoopStopsTest, AfterAFaultTheArmMustBeClearedAndEnabledAgain) {
  ClientBench bench;
  bench.Start();
  bench.Ticks(10);
  bench.arm.faults = kFaultStall;
  bench.Tick();
  ASSERT_EQ(bench.loop->state(), ClientState::kFault);
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kMoving);
  bench.Ticks(30);
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kFaults);
  bench.arm.faults = 0;
  bench.Ticks(5);
  EXPECT_EQ(bench.loop->state(), ClientState::kFault) << "latched";
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  bench.Tick(kRequestEnable);
  bench.Tick(kRequestStart);
  bench.Ticks(3);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  EXPECT_EQ(bench.loop->episode(), 1);
}

// ----------------------------------------------------------- set going only where it stands now

TEST(ControlLoopStopsTest, NothingIsEnabledOnAPoseThatIsOld) {
  ClientBench bench;
  bench.Ticks(10);
  bench.arm.silent = true;
  bench.Ticks(3);
  bench.Tick(kRequestEnable);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  EXPECT_EQ(bench.arm.enables, 0) << "it got no power";
  EXPECT_EQ(bench.arm.sends, 0);
  EXPECT_THAT(std::string(bench.loop->enable_status().message()),
              ::testing::AllOf(::testing::HasSubstr("old"), ::testing::HasSubstr("ms")));
}

TEST(ControlLoopStopsTest, AnArmThatMovesIsNotEnabledClearedOrStarted) {
  ClientBench bench;
  bench.arm.drift = 0.06;
  bench.Ticks(3);
  bench.Tick(kRequestEnable);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  EXPECT_EQ(bench.arm.enables, 0);
  EXPECT_THAT(std::string(bench.loop->enable_status().message()), ::testing::HasSubstr("moves"));
  bench.arm.drift = 0;
  bench.Ticks(5);
  bench.Tick(kRequestEnable);
  ASSERT_EQ(bench.loop->state(), ClientState::kEnabled);
  bench.arm.drift = 0.06;
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kMoving);
}

// As it was found: a fault for silence, the arm moved by hand meanwhile, clear, enable.
TEST(ControlLoopStopsTest, AfterSilenceTheFirstCommandIsWhereTheArmIsNow) {
  ClientBench bench;
  bench.Start();
  bench.Ticks(20);
  bench.arm.silent = true;
  bench.Ticks(12);
  ASSERT_EQ(bench.loop->state(), ClientState::kFault);
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->state(), ClientState::kFault) << "nobody knows where it is";
  EXPECT_EQ(bench.loop->refusal(), Refusal::kStale);
  bench.arm.silent = false;
  bench.arm.bias = 0.4;  // somewhere else
  bench.arm.Send({bench.arm.Latest().position}).IgnoreError();
  bench.Ticks(60);
  bench.Tick(kRequestClear);
  ASSERT_EQ(bench.loop->state(), ClientState::kIdle);
  const ArmVector stands = bench.arm.Latest().position;
  bench.Tick(kRequestEnable);
  ASSERT_EQ(bench.loop->state(), ClientState::kEnabled);
  for (int j = 0; j < ArmAxes().joints; ++j)
    EXPECT_NEAR(bench.arm.last.position[j], stands[j], 1e-3) << j;
  bench.Ticks(10);
  for (int j = 0; j < ArmAxes().joints; ++j)
    EXPECT_NEAR(bench.arm.last.position[j], stands[j], 1e-3) << j;
}

TEST(ControlLoopStopsTest, AnEpisodeStartsOnlyWhereTheArmIsSent) {
  ClientBench bench;
  bench.Tick(kRequestEnable);
  bench.Ticks(5);
  bench.arm.blocked = true;
  bench.arm.bias = 0;
  bench.arm.blocked_at(0, bench.arm.Latest().position[0] + 0.2);
  bench.Ticks(2);
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kApart);
}

TEST(ControlLoopStopsTest, AnEnableThatIsUnderWayIsCancelledByAPress) {
  struct SlowArm : FakeArm {
    using FakeArm::FakeArm;
    absl::Status Enable(const std::function<bool()>& cancelled) override {
      during();
      return cancelled() ? absl::CancelledError("cancelled") : FakeArm::Enable(cancelled);
    }
    std::function<void()> during;
  };
  for (int kind = 0; kind < 3; ++kind) {
    ManualClock clock{1'000'000'000};
    SlowArm arm(&clock);
    ASSERT_TRUE(arm.Connect().ok());
    NoCameras cameras;
    auto loop = *ControlLoop::Create({}, &arm, &clock, &cameras);
    std::atomic<int> presses{0}, gentle{0};
    loop->ObeyStops(&presses, &gentle);
    arm.during = [&] {
      if (kind == 0) ++presses;
      if (kind == 1) ++gentle;
      if (kind == 2) loop->Ask(kRequestHold);
    };
    loop->Ask(kRequestEnable);
    loop->Tick(clock.now_ns());
    EXPECT_EQ(loop->state(), ClientState::kIdle) << kind;
    EXPECT_EQ(arm.enables, 0) << kind;
  }
}

TEST(ControlLoopStopsTest, ATerminationHoldsHoweverOftenItComes) {
  ClientBench bench;
  std::atomic<int> presses{0}, gentle{0};
  bench.loop->ObeyStops(&presses, &gentle);
  bench.Start();
  bench.Ticks(10);
  gentle += 2;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  ++gentle;
  bench.Ticks(10);
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.arm.quick_stops, 0) << "the arm does not sink";
}

TEST(ControlLoopStopsTest, AFaultLetsGoOnceAndThenSendsNothing) {
  ClientBench bench;
  bench.policy_speed = 0.9;
  bench.Start();
  bench.Ticks(15);
  bench.arm.blocked = true;
  bench.Ticks(5);
  ASSERT_GT(std::abs(bench.arm.last.position[0] - bench.arm.Latest().position[0]), 0.05);
  bench.arm.faults = kFaultStall;
  const int sends = bench.arm.sends;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  EXPECT_EQ(bench.arm.sends, sends + 1);
  EXPECT_EQ(bench.arm.last.position[0], bench.arm.Latest().position[0]);
  bench.Ticks(10);
  EXPECT_EQ(bench.arm.sends, sends + 1);
}

// In mid-motion, with something 30 mm wide between fingers that were told to close.
struct GraspBench : ClientBench {
  GraspBench() {
    policy_speed = 0.9;
    policy_opening = 0;
    arm.grasped = 0.03;
    Start();
    Ticks(20);
    EXPECT_NEAR(Opening(), 0, 1e-4);
    arm.blocked = true;
    Ticks(5);
  }
  double Opening() const { return arm.last.position[ArmAxes().opening()]; }
  void Fault(uint32_t fault) {
    arm.faults = fault;
    Tick();
    EXPECT_EQ(loop->state(), ClientState::kFault);
  }
  void EnableAgain() {
    arm.faults = 0;
    Ticks(10);
    Tick(kRequestClear);
    Tick(kRequestEnable);
    EXPECT_EQ(loop->state(), ClientState::kEnabled);
  }
};

TEST(ControlLoopStopsTest, WhatTheGripperHoldsStaysHeldWhereTheJointsLetGo) {
  GraspBench held;
  for (int i = 0; i < 60 && held.loop->state() == ClientState::kRun; ++i) held.Tick();
  EXPECT_EQ(held.loop->cause(), StateCause::kBlocked);
  held.Ticks(60);
  EXPECT_NEAR(held.arm.last.position[0], held.arm.Latest().position[0], 0.03);
  EXPECT_NEAR(held.Opening(), 0, 1e-4);

  GraspBench fault;
  fault.Fault(kFaultStall);
  EXPECT_EQ(fault.arm.last.position[0], fault.arm.Latest().position[0]);
  EXPECT_NEAR(fault.Opening(), 0, 1e-4);
  fault.EnableAgain();
  EXPECT_EQ(fault.arm.last.position[0], fault.arm.Latest().position[0]);
  EXPECT_NEAR(fault.Opening(), 0, 1e-4);
}

// Somebody's fingers may be between its own.
TEST(ControlLoopStopsTest, AGripperThatWasLimpOrAtFaultDoesNotCloseAgain) {
  GraspBench limp;
  limp.Fault(kFaultStall);
  limp.arm.lost_enable = true;
  limp.Ticks(3);
  limp.arm.lost_enable = false;
  limp.EnableAgain();
  EXPECT_NEAR(limp.Opening(), 0.03, 1e-9);

  GraspBench strained;
  strained.arm.blocked = false;
  strained.policy_speed = 0;
  strained.Ticks(60);
  strained.Fault(kFaultGripper);
  EXPECT_NEAR(strained.Opening(), 0.03, 1e-9) << "though its joints stand at their command";
  strained.EnableAgain();
  EXPECT_NEAR(strained.Opening(), 0.03, 1e-9);
}

TEST(ControlLoopStopsTest, IsSettledOnceCommandAndArmStand) {
  ClientBench bench;
  EXPECT_TRUE(bench.loop->settled());
  bench.policy_speed = 0.9;
  bench.Start();
  bench.Ticks(20);
  EXPECT_FALSE(bench.loop->settled());
  bench.loop->Ask(kRequestHold);
  EXPECT_FALSE(bench.loop->settled());
  int ticks = 0;
  while (!bench.loop->settled() && ++ticks < 60) bench.Tick();
  EXPECT_GT(ticks, 5) << "it brakes";
  EXPECT_LT(ticks, 30);
  const ArmVector rest = bench.arm.last.position;
  bench.loop->Ask(kRequestResume);
  EXPECT_FALSE(bench.loop->settled()) << "who knows what becomes of it";
  bench.loop->Ask(kRequestHold);
  bench.Ticks(10);
  EXPECT_TRUE(bench.loop->settled());
  EXPECT_EQ(bench.arm.last.position, rest);
}

}  // namespace
}  // namespace robostress
