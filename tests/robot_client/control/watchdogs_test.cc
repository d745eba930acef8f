#include "robot_client/control/watchdogs.h"

#include <gtest/gtest.h>

#include <limits>

#include "robot_client/control/state_machine.h"

namespace robostress {
namespace {

constexpr int64_t kSecond = 1'000'000'000;

Watchdogs::Inputs Healthy() {
  Watchdogs::Inputs in;
  in.now_ns = 100 * kSecond;
  in.arm.sequence = 5;
  in.arm.enabled = true;
  in.arm.stamp_ns = in.now_ns - kSecond / 200;
  in.oldest_camera_ns = in.now_ns - kSecond / 30;
  in.streaming = in.running = true;
  return in;
}

Watchdogs Started() {
  Watchdogs dogs({}, 1.0 / 30);
  dogs.OnRunStart(100 * kSecond);
  return dogs;
}

TEST(WatchdogsTest, SayNothingOfAHealthyTick) {
  Watchdogs dogs = Started();
  const WatchdogVerdict verdict = dogs.Check(Healthy());
  EXPECT_EQ(verdict.fault, StateCause::kNone);
  EXPECT_EQ(verdict.hold, StateCause::kNone);
  EXPECT_FALSE(verdict.camera_late);
}

TEST(WatchdogsTest, ASilentArmIsHeldThenAFault) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.arm.stamp_ns = in.now_ns - kSecond * 6 / 100;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kArmSilent);
  EXPECT_EQ(dogs.Check(in).fault, StateCause::kNone);
  in.arm.stamp_ns = in.now_ns - kSecond * 26 / 100;
  EXPECT_EQ(dogs.Check(in).fault, StateCause::kArmSilent);
}

TEST(WatchdogsTest, CamerasAreMarkedThenHeld) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.oldest_camera_ns = in.now_ns - kSecond / 5;
  EXPECT_TRUE(dogs.Check(in).camera_late);
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kNone);
  in.oldest_camera_ns = in.now_ns - kSecond;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kCameraStale);
  in.oldest_camera_ns = 0;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kCameraStale) << "one has never delivered";
}

TEST(WatchdogsTest, TheFirstChunkMayTakeLongerThanTheOthers) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.now_ns += 3 * kSecond;
  in.arm.stamp_ns = in.oldest_camera_ns = in.now_ns;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kNone);
  dogs.OnRow(in.now_ns);
  in.now_ns += 3 * kSecond;
  in.arm.stamp_ns = in.oldest_camera_ns = in.now_ns;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kServerSilent);
}

TEST(WatchdogsTest, AFollowingErrorMustLast) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.command[3] = 0.4;
  for (int i = 0; i < 15; ++i) EXPECT_EQ(dogs.Check(in).hold, StateCause::kNone) << i;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kFollowingError);
  in.command[3] = 0;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kNone);
}

TEST(WatchdogsTest, FaultBitsLostEnableAndNonsenseAreFaults) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.arm.faults = kFaultCollision;
  EXPECT_EQ(dogs.Check(in).fault, StateCause::kArmFault);
  in = Healthy();
  in.arm.enabled = false;
  EXPECT_EQ(dogs.Check(in).fault, StateCause::kArmDisabled);
  in = Healthy();
  in.arm.position[2] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(dogs.Check(in).fault, StateCause::kNotFinite);
}

TEST(WatchdogsTest, ABusThatTakesNothingIsHeldThenAFault) {
  Watchdogs dogs = Started();
  for (int i = 0; i < 3; ++i) dogs.OnSend(false);
  EXPECT_EQ(dogs.Check(Healthy()).hold, StateCause::kSendFailed);
  for (int i = 0; i < 12; ++i) dogs.OnSend(false);
  EXPECT_EQ(dogs.Check(Healthy()).fault, StateCause::kSendFailed);
  dogs.OnSend(true);
  EXPECT_EQ(dogs.Check(Healthy()).fault, StateCause::kNone);
}

TEST(StateMachineTest, OnlyRequestsLeaveHoldAndFault) {
  StateMachine machine;
  machine.Enabled();
  ASSERT_TRUE(machine.Advance(kRequestStart, {}, 0));
  ASSERT_EQ(machine.state(), ClientState::kRun);
  ASSERT_TRUE(machine.Advance(0, {.hold = StateCause::kServerSilent}, 0));
  ASSERT_EQ(machine.state(), ClientState::kHold);
  for (int i = 0; i < 100; ++i) EXPECT_FALSE(machine.Advance(0, {}, 0));
  EXPECT_FALSE(machine.Advance(kRequestResume, {.hold = StateCause::kCameraStale}, 0))
      << "what holds it must be gone";
  EXPECT_TRUE(machine.Advance(kRequestResume, {}, 0));
  EXPECT_TRUE(machine.Advance(0, {.fault = StateCause::kArmFault}, kFaultStall));
  for (int i = 0; i < 100; ++i)
    EXPECT_FALSE(machine.Advance(kRequestResume | kRequestStart, {}, 0));
  EXPECT_FALSE(machine.Advance(kRequestClear, {}, kFaultStall)) << "the arm still reports it";
  EXPECT_TRUE(machine.Advance(kRequestClear, {}, 0));
  EXPECT_EQ(machine.state(), ClientState::kIdle) << "clearing does not enable";
}

TEST(StateMachineTest, AStopWinsOverEverythingElseAskedForAtOnce) {
  StateMachine machine;
  machine.Enabled();
  machine.Advance(kRequestStart, {}, 0);
  machine.Advance(kRequestHold | kRequestResume | kRequestStart, {}, 0);
  EXPECT_EQ(machine.state(), ClientState::kHold);
  machine.Advance(kRequestHold | kRequestResume, {}, 0);
  EXPECT_EQ(machine.state(), ClientState::kHold);
  machine.Advance(kRequestQuickStop | kRequestResume, {}, 0);
  EXPECT_EQ(machine.state(), ClientState::kFault);
  EXPECT_TRUE(machine.quick_stop());
  machine.Advance(kRequestClear, {}, 0);
  EXPECT_FALSE(machine.quick_stop());
}

}  // namespace
}  // namespace robostress
