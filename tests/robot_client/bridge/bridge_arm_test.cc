#include "robot_client/bridge/bridge_arm.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <string>
#include <tuple>

#include "absl/strings/str_join.h"
#include "tests/robot_client/bridge/scripted_driver.h"
#include "tests/sim_worker/allocation_counter.h"

namespace robostress::bridge {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string Said(const absl::Status& status) { return std::string(status.message()); }

TEST(BridgeArm, ConnectsAndSaysWhatTheDriverCannotDo) {
  BridgeWorld world;
  world.driver->welcome["stop"] = false;
  world.driver->welcome["note"] = "mind the cat";
  ASSERT_TRUE(world.Connected().ok());
  EXPECT_THAT(world.driver->greeting,
              AllOf(HasSubstr(R"("axes":["pan","lift","elbow","flex","roll","jaw"])"),
                    HasSubstr(R"("gripper":"jaw")")));
  EXPECT_EQ(world.arm->description(), "five behind scripted (five servos) at a stream");
  const ArmSnapshot seen = world.arm->Latest();
  EXPECT_GT(seen.sequence, 0u);
  EXPECT_FALSE(seen.enabled);
  EXPECT_NEAR(seen.position[1], 0.1, 1e-12);
  EXPECT_NEAR(seen.position[5], 0.04, 1e-12);
  EXPECT_EQ(seen.position[6], 0) << "an axis that it has not";
  const std::string warnings = absl::StrJoin(world.arm->Warnings(), "\n");
  EXPECT_THAT(warnings,
              AllOf(HasSubstr("J2 lift"), HasSubstr("silent for 0.25 s"), HasSubstr("says: hold"),
                    HasSubstr("WARNING: the driver has no stop"), HasSubstr("mind the cat")));
  EXPECT_THAT(warnings, HasSubstr("table, box and the arm against itself are not watched"));
  EXPECT_THAT(world.arm->stop_effect(), HasSubstr("holds where the arm stands"));
  EXPECT_EQ(world.driver->commands + world.driver->enables, 0) << "nothing moves by itself";
}

TEST(BridgeArm, RefusesADriverThatCanDoLess) {
  const auto refused = [](const std::function<void(ScriptedDriver&)>& change,
                          const std::string& yaml = kFiveServos) {
    BridgeWorld world(yaml);
    change(*world.driver);
    const absl::Status status = world.Connected();
    EXPECT_FALSE(status.ok());
    return Said(status);
  };
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.welcome["torque_off"] = false; }),
              AllOf(HasSubstr("expects: torque_off"), HasSubstr("under driver:")));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.welcome["on_silence"] = "nothing"; }),
              HasSubstr("it does nothing when this client is silent"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.welcome["simulated"] = false; }),
              HasSubstr("its arm is real"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.welcome["protocol"] = 2; }),
              HasSubstr("speaks version 2, this client 1"));
  EXPECT_THAT(refused([](ScriptedDriver& d) {
                d.welcome["axes"] = {"pan", "lift", "elbow", "flex", "roll"};
              }),
              HasSubstr("correct the names in the file"));
  EXPECT_THAT(refused([](ScriptedDriver& d) {
                d.welcome["axes"] = {"lift", "pan", "elbow", "flex", "roll", "jaw"};
              }),
              HasSubstr("correct the names"))
      << "the same names in another order";
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.welcome.erase("stop"); }), HasSubstr("stop"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.silent = true; }),
              HasSubstr("no state of the arm"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.reads = false; }), HasSubstr("no welcome within"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.nan = true; }), HasSubstr("are no numbers"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.HangUp(); }), HasSubstr("hung up"));
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.stamp_back_ns = 2'000'000'000; }),
              HasSubstr("s behind this machine's CLOCK_MONOTONIC"));
  EXPECT_THAT(refused([](ScriptedDriver& d) {
                d.WriteText(FrameKind::kRefusal, R"({"reason":"another client drives this arm"})");
              }),
              HasSubstr("the driver refuses: another client drives this arm"));
  EXPECT_THAT(refused([](ScriptedDriver& d) {
                d.WriteText(FrameKind::kRefusal, R"({"reason":"busy"})");
                d.HangUp();
              }),
              HasSubstr("the driver refuses: busy"))
      << "said before it hung up";
  EXPECT_THAT(refused([](ScriptedDriver& d) { d.Write("HTTP/1.1 400 Bad Request", 24); }),
              HasSubstr("bytes that are no frame instead of a welcome"));
}

TEST(BridgeArm, EnablesWithoutMovingAndSendsInTheDriversUnits) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  EXPECT_FALSE(world.arm->Send({}).ok()) << "before Enable";
  const ArmVector before = world.driver->position;
  const absl::Status enabled = world.arm->Enable();
  ASSERT_TRUE(enabled.ok()) << enabled;
  EXPECT_TRUE(world.arm->Latest().enabled);
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(world.driver->position[i], before[i], 1e-9);
  ArmCommand command;
  command.position = {0.5, -0.25, 0.1, 1.0, 0, 0.02};
  command.gripper_effort = 0.75;
  ASSERT_TRUE(world.arm->Send(command).ok());
  world.clock.SleepUntil(world.clock.now_ns() + 5'000'000);
  const CommandFrame& last = world.driver->last;
  EXPECT_NEAR(last.position[0], 0.5 * 180 / M_PI, 1e-9);
  EXPECT_NEAR(last.position[1], 0.75 * 180 / M_PI, 1e-9) << "the other way round, from 0.5 rad";
  EXPECT_NEAR(last.position[2], 0.1, 1e-12);
  EXPECT_NEAR(last.position[3], 50, 1e-9);
  EXPECT_NEAR(last.position[5], 25, 1e-9);
  EXPECT_EQ(last.gripper_effort, 0.75);
  command.position[0] = 1.9;
  EXPECT_EQ(world.arm->Send(command).code(), absl::StatusCode::kInvalidArgument);
  command.position[0] = std::nan("");
  EXPECT_EQ(world.arm->Send(command).code(), absl::StatusCode::kInvalidArgument);
}

TEST(BridgeArm, EnabledAgainItsGripperGoesOnHoldingUnlessItWasLimp) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  ASSERT_TRUE(world.arm->Enable().ok());
  const auto wait = [&] {
    world.clock.SleepUntil(world.clock.now_ns() + 300'000'000);
    world.arm->Poll();
  };
  wait();
  const CommandFrame& last = world.driver->last;
  EXPECT_NEAR(last.position[5], 50, 1e-9) << "where it stands";
  EXPECT_EQ(last.gripper_effort, 0);
  ArmCommand command;
  command.position = world.arm->Latest().position;
  command.position[5] = 0;
  command.gripper_effort = 0.75;
  world.driver->grasped = 0.03;
  ASSERT_TRUE(world.arm->Send(command).ok());
  wait();
  world.driver->last = {};
  ASSERT_TRUE(world.arm->Enable().ok());
  wait();
  EXPECT_NEAR(last.position[5], 0, 1e-9) << "it holds something";
  EXPECT_EQ(last.gripper_effort, 0.75);
  world.driver->powered = false;
  wait();
  ASSERT_TRUE(world.arm->Enable().ok());
  wait();
  EXPECT_NEAR(last.position[5], 37.5, 1e-9) << "somebody's finger may be there";
  EXPECT_EQ(last.gripper_effort, 0);
}

TEST(BridgeArm, AnUnwillingDriverIsNotEnabled) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  world.driver->obeys_enable = false;
  EXPECT_THAT(Said(world.arm->Enable()), HasSubstr("does not say within 5 s"));
  EXPECT_FALSE(world.arm->Send({}).ok());
  world.driver->obeys_enable = true;
  EXPECT_EQ(world.arm->Enable([] { return true; }).code(), absl::StatusCode::kCancelled);
  world.driver->silent = true;
  world.clock.SleepUntil(world.clock.now_ns() + 100'000'000);
  EXPECT_THAT(Said(world.arm->Enable()), HasSubstr("where the arm stands is not known"));
}

TEST(BridgeArm, EstimatesVelocitiesThatTheDriverDoesNotMeasure) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  ASSERT_TRUE(world.arm->Enable().ok());
  ArmCommand command;
  command.position = world.arm->Latest().position;
  for (int tick = 0; tick < 20; ++tick) {
    command.position[0] += 0.5 / 100;
    ASSERT_TRUE(world.arm->Send(command).ok());
    world.clock.SleepUntil(world.clock.now_ns() + 10'000'000);
    world.arm->Poll();
  }
  EXPECT_NEAR(world.arm->Latest().velocity[0], 0.5, 0.05);
  world.clock.SleepUntil(world.clock.now_ns() + 200'000'000);
  world.arm->Poll();
  EXPECT_NEAR(world.arm->Latest().velocity[0], 0, 1e-9);
}

TEST(BridgeArm, HeartbeatsGoOutWhereNothingElseDoes) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  for (int tick = 0; tick < 30; ++tick) {
    world.arm->Poll();
    world.clock.SleepUntil(world.clock.now_ns() + BridgeWorld::kPeriod_ns);
  }
  EXPECT_GE(world.driver->heartbeats, 14) << "a second: less than a driver's watchdog apart";
}

TEST(BridgeArm, TakesNoStateTwiceNorOneOfATimeToCome) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  const auto poll = [&] {
    world.clock.SleepUntil(world.clock.now_ns() + 20'000'000);
    world.arm->Poll();
    return world.arm->Latest();
  };
  uint64_t seen = poll().sequence;
  world.driver->frozen_sequence = true;
  EXPECT_EQ(poll().sequence, seen) << "the sequence does not grow";
  world.driver->frozen_sequence = false;
  EXPECT_GT(poll().sequence, seen);
  seen = world.arm->Latest().sequence;
  world.driver->stamp_back_ns = 500'000'000;
  EXPECT_EQ(poll().sequence, seen) << "older than what is known";
  world.driver->stamp_back_ns = -500'000'000;
  EXPECT_EQ(poll().sequence, seen) << "of a time to come";
  EXPECT_GE(world.arm->counters().repeated, 3u);
  world.driver->stamp_back_ns = 0;
  EXPECT_GT(poll().sequence, seen);
}

TEST(BridgeArm, AJumpIsNotTakenUntilAPersonHasLooked) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  const double before = world.arm->Latest().position[0];
  world.driver->shift = 0.5;
  world.clock.SleepUntil(world.clock.now_ns() + 20'000'000);
  world.arm->Poll();
  EXPECT_EQ(world.arm->Latest().position[0], before);
  EXPECT_GE(world.arm->counters().jumps, 1u);
  world.clock.SleepUntil(world.clock.now_ns() + 2'000'000'000);
  world.arm->Poll();
  EXPECT_EQ(world.arm->Latest().position[0], before) << "time makes it no likelier";
  world.driver->shift = 0;
  world.clock.SleepUntil(world.clock.now_ns() + 20'000'000);
  world.arm->Poll();
  EXPECT_GT(world.arm->Latest().stamp_ns, world.clock.now_ns() - 20'000'000) << "it was a glitch";
  world.driver->shift = 0.5;
  world.clock.SleepUntil(world.clock.now_ns() + 20'000'000);
  world.arm->Poll();
  world.arm->Acknowledge();
  world.clock.SleepUntil(world.clock.now_ns() + 20'000'000);
  world.arm->Poll();
  EXPECT_NEAR(world.arm->Latest().position[0], before + 0.5, 1e-9);
}

TEST(BridgeArm, ADriverThatDoesNotReadIsToldByAnError) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  ASSERT_TRUE(world.arm->Enable().ok());
  world.driver->reads = false;
  ArmCommand command;
  command.position = world.arm->Latest().position;
  int taken = 0;
  while (taken < 1000 && world.arm->Send(command).ok()) ++taken;
  EXPECT_LT(taken, 60) << "old commands would be worked off afterwards";
  EXPECT_EQ(world.arm->Send(command).code(), absl::StatusCode::kResourceExhausted);
  world.driver->reads = true;
  world.clock.SleepUntil(world.clock.now_ns() + 2'000'000);
  EXPECT_TRUE(world.arm->Send(command).ok()) << "no part of a frame was sent";
}

TEST(BridgeArm, PowerOffIsAskedOfADriverThatCan) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  ASSERT_TRUE(world.arm->Enable().ok());
  EXPECT_TRUE(world.arm->Disable().ok());
  EXPECT_FALSE(world.driver->powered);
  std::string yaml = kFiveServos;
  yaml.replace(yaml.find("torque_off: true"), 16, "torque_off: false");
  BridgeWorld without(yaml);
  without.driver->welcome["torque_off"] = false;
  ASSERT_TRUE(without.Connected().ok());
  EXPECT_THAT(Said(without.arm->Disable()), HasSubstr("use the switch"));
}

TEST(BridgeArm, SaysGoodbye) {
  BridgeWorld world;
  ASSERT_TRUE(world.Connected().ok());
  world.clock.driver = nullptr;
  world.arm.reset();
  world.driver->Turn(world.clock.now_ns());
  EXPECT_EQ(world.driver->enables, 0);
}

TEST(BridgeArm, SevenJointsTravelBothWays) {
  BridgeWorld world(SevenJoints());
  ASSERT_TRUE(world.Connected().ok());
  EXPECT_THAT(world.driver->greeting,
              HasSubstr(R"("axes":["j1","j2","j3","j4","j5","j6","j7","hand"])"));
  EXPECT_NEAR(world.arm->Latest().position[6], 0.6, 1e-12);
  EXPECT_NEAR(world.arm->Latest().position[7], 0.04, 1e-12);
  ASSERT_TRUE(world.arm->Enable().ok());
  ArmCommand command;
  command.position = world.arm->Latest().position;
  command.position[6] = -1.25;
  command.position[7] = 0.06;
  ASSERT_TRUE(world.arm->Send(command).ok());
  world.clock.SleepUntil(world.clock.now_ns() + 5'000'000);
  EXPECT_NEAR(world.driver->last.position[6], -1.25, 1e-12);
  EXPECT_NEAR(world.driver->last.position[7], 0.03, 1e-12) << "of one finger";
  command.position[6] = 2.1;
  EXPECT_EQ(world.arm->Send(command).code(), absl::StatusCode::kInvalidArgument);
  command.position[6] = 0;
  command.position[7] = 0.09;
  EXPECT_EQ(world.arm->Send(command).code(), absl::StatusCode::kInvalidArgument);
}

TEST(BridgeArm, EnablesNoArmWhoseLastJointMoves) {
  BridgeWorld world(SevenJoints());
  ASSERT_TRUE(world.Connected().ok());
  world.driver->target[6] = -2;
  world.clock.SleepUntil(world.clock.now_ns() + 100'000'000);
  EXPECT_THAT(Said(world.arm->Enable()), HasSubstr("J7 moves at -2.0"));
}

TEST(BridgeArm, AllocatesNothingInTheLoop) {
  if (!CountsAllocations()) GTEST_SKIP() << "a sanitizer owns malloc";
  BridgeWorld world(SevenJoints());
  ASSERT_TRUE(world.Connected().ok());
  ASSERT_TRUE(world.arm->Enable().ok());
  ArmCommand command, refused;
  command.position = world.arm->Latest().position;
  refused.position[0] = 5;
  long counted = 0;
  const auto tick = [&](const std::function<void()>& what) {
    const long before = Allocations();
    what();
    counted += Allocations() - before;
    world.clock.SleepUntil(world.clock.now_ns() + BridgeWorld::kPeriod_ns);
  };
  for (int i = 0; i < 60; ++i) {
    tick([&] {
      world.arm->Poll();
      std::ignore = world.arm->Latest();
      std::ignore = world.arm->Send(command).ok();
      std::ignore = world.arm->Send(refused).ok();
    });
  }
  world.driver->nan = true;
  tick([&] { world.arm->Poll(); });
  world.driver->floods = 500;
  tick([&] { world.arm->Poll(); });
  tick([&] { world.arm->QuickStop().IgnoreError(); });
  tick([&] { world.arm->Acknowledge(); });
  world.driver->HangUp();
  tick([&] { world.arm->Poll(); });
  tick([&] { std::ignore = world.arm->Send(command).ok(); });
  EXPECT_EQ(counted, 0);
}

}  // namespace
}  // namespace robostress::bridge
