#include "robot_client/control/watchdogs.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "robot_client/control/control_options.h"
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
  Watchdogs dogs({}, 1.0 / 30, 6);
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

TEST(WatchdogsTest, AStampOfATimeToComeIsNoFreshOne) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.oldest_camera_ns = in.now_ns + kSecond / 100;  // a driver's rounding
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kNone);
  in.oldest_camera_ns = in.now_ns + kSecond;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kCameraStale);
  EXPECT_TRUE(dogs.Check(in).camera_late);
  in = Healthy();
  in.arm.stamp_ns = in.now_ns + kSecond;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kArmSilent);
  EXPECT_EQ(dogs.Check(in).fault, StateCause::kArmSilent);
}

TEST(WatchdogsTest, PressingBlockingDelayBoundsRecordAndNonsenseAreHeld) {
  Watchdogs dogs = Started();
  Watchdogs::Inputs in = Healthy();
  in.pressing = true;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kPressing);
  in = Healthy();
  in.blocked = true;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kBlocked);
  in = Healthy();
  in.guarded = true;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kWorkspace);
  in = Healthy();
  in.record_failed = true;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kRecordFailed);
  in = Healthy();
  in.policy_invalid = true;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kPolicyInvalid);
  in = Healthy();
  in.delay_s = 0.24;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kNone);
  in.delay_s = 0.26;
  EXPECT_EQ(dogs.Check(in).hold, StateCause::kDelayed);
}

template <class Options>
struct Ranged {
  const char* name;
  double Options::*value;
  double least, most;
};
// Every option at both ends of its range, a little beyond, and at what is no number.
template <class Options>
void ExpectRanges(
    const std::vector<Ranged<Options>>& options,
    const std::function<absl::Status(const Options&, std::vector<std::string>)>& check) {
  EXPECT_TRUE(check({}, {}).ok());
  for (const auto& [name, value, least, most] : options) {
    Options o;
    for (const double good : {least, most}) {
      o.*value = good;
      EXPECT_TRUE(check(o, {}).ok()) << name << " " << good;
    }
    for (const double bad : {0.9 * least, 1.1 * most, -1.0, std::numeric_limits<double>::infinity(),
                             std::numeric_limits<double>::quiet_NaN()}) {
      if (bad == least) continue;  // 0
      o.*value = bad;
      const absl::Status status = check(o, {});
      EXPECT_TRUE(absl::IsInvalidArgument(status)) << name << " " << bad;
      EXPECT_NE(status.message().find(name), absl::string_view::npos) << status;
      EXPECT_EQ(check(o, {name}).ok(), bad > 0) << name << " " << bad;
    }
  }
}

TEST(WatchdogsTest, AValueThatGuardsNothingIsRefusedUnlessTheGuardIsGivenUpByName) {
  using W = WatchdogOptions;
  ExpectRanges<W>({{"arm_hold_s", &W::arm_hold_s, 0.01, 0.2},
                   {"arm_fault_s", &W::arm_fault_s, 0.05, 1},
                   {"camera_mark_s", &W::camera_mark_s, 0.01, 1},
                   {"camera_hold_s", &W::camera_hold_s, 0.05, 2},
                   {"server_hold_s", &W::server_hold_s, 0.1, 10},
                   {"first_chunk_s", &W::first_chunk_s, 0.1, 120},
                   {"following_error", &W::following_error, 0.01, 1},
                   {"following_s", &W::following_s, 0.05, 2},
                   {"delay_hold_s", &W::delay_hold_s, 0.05, 0.5}},
                  [](const W& o, const auto& given_up) { return CheckGuards(o, {}, given_up); });
  using P = PressOptions;
  ExpectRanges<P>({{"excess_s", &P::excess_s, 0.01, 1},
                   {"payload_kg", &P::payload_kg, 0, 5},
                   {"blocked_error", &P::blocked_error, 0.01, 0.35},
                   {"blocked_s", &P::blocked_s, 0.1, 3},
                   {"blocked_travel", &P::blocked_travel, 0.001, 0.1}},
                  [](const P& o, const auto& given_up) { return CheckGuards({}, o, given_up); });
  WatchdogOptions ticks;
  ticks.send_hold_ticks = 1'000'000;
  EXPECT_FALSE(CheckGuards(ticks, {}, {}).ok());
  EXPECT_FALSE(CheckGuards({}, {}, {"brakes"}).ok()) << "no such guard";
}

TEST(WatchdogsTest, ARateThatTheRestDoesNotSupportIsRefused) {
  ControlOptions o;
  for (const double good : {5.0, 30.0, 200.0}) {
    o.rate_hz = good;
    EXPECT_TRUE(CheckControlOptions(o, 6).ok()) << good;
  }
  for (const double bad : {4.9, 201.0, 1000.0, std::numeric_limits<double>::quiet_NaN()}) {
    o.rate_hz = bad;
    EXPECT_NE(CheckControlOptions(o, 6).message().find("control.rate_hz is"), std::string::npos)
        << bad;
  }
  o.rate_hz = 30;
  o.press.excess[2] = 0;
  EXPECT_NE(CheckControlOptions(o, 6).message().find("press.excess holds 0, must be 0.01 to 100"),
            std::string::npos);
}

TEST(StateMachineTest, AMotionOfTheClientsOwnEndsWhereItIsStoppedAndIsNotResumed) {
  const WatchdogVerdict fine;
  StateMachine machine;
  machine.Enabled();
  EXPECT_TRUE(machine.Advance(kRequestMove, fine, 0));
  EXPECT_EQ(machine.state(), ClientState::kMove);
  EXPECT_TRUE(machine.Advance(kRequestHold, fine, 0));
  EXPECT_EQ(machine.state(), ClientState::kEnabled);
  machine.Advance(kRequestMove, fine, 0);
  WatchdogVerdict pressing;
  pressing.hold = StateCause::kPressing;
  machine.Advance(0, pressing, 0);
  EXPECT_EQ(machine.state(), ClientState::kHold);
  EXPECT_FALSE(machine.Advance(kRequestResume, fine, 0)) << "there is no episode to go on with";
  machine.Advance(kRequestEnd, fine, 0);
  EXPECT_EQ(machine.state(), ClientState::kEnabled);
  EXPECT_FALSE(machine.Advance(kRequestMove, pressing, 0));
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
