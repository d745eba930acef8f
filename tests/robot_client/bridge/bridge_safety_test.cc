// The table of docs/results/arm-bridge.md: what the client's loop does when a driver, or the arm
// behind it, fails. In simulated time.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "tests/robot_client/bridge/scripted_driver.h"

namespace robostress::bridge {
namespace {

using ::testing::HasSubstr;

struct Ended {
  ClientState state;
  StateCause cause;
  double seconds;
  uint32_t faults;
};

// In mid-motion `act` happens.
Ended After(const char* name, BridgeWorld& world, const std::function<void()>& act) {
  world.Open();
  world.Run();
  act();
  const double seconds = world.SecondsUntilLeft(ClientState::kRun);
  const Ended ended{world.loop->state(), world.loop->cause(), seconds,
                    world.loop->last_record().faults};
  std::printf("%s: %s (%s) after %.3f s\n", name, StateName(ended.state), CauseName(ended.cause),
              seconds);
  return ended;
}

// Nothing that was told moves the arm any more.
void ExpectStands(BridgeWorld& world) {
  world.Ticks(30);
  const ArmVector before = world.driver->position;
  world.Ticks(30);
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(world.driver->position[i], before[i], 1e-3);
}

TEST(BridgeSafety, AnEpisodeRunsAndMovesTheArm) {
  BridgeWorld world;
  world.Open();
  world.Run();
  const double before = world.driver->position[0];
  world.Ticks(30);
  EXPECT_GT(world.driver->position[0], before + 0.1);
  EXPECT_EQ(world.loop->state(), ClientState::kRun);
  EXPECT_EQ(world.driver->last.position[5], 50) << "the gripper stays";
}

TEST(BridgeSafety, ADriverThatDiesIsAFaultInTheNextTick) {
  BridgeWorld world;
  const Ended ended = After("dies", world, [&] { world.driver->HangUp(); });
  EXPECT_EQ(ended.state, ClientState::kFault);
  EXPECT_EQ(ended.cause, StateCause::kArmFault);
  EXPECT_EQ(ended.faults, kFaultBus);
  EXPECT_LE(ended.seconds, 0.034);
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kFault) << "nobody listens";
  EXPECT_EQ(world.loop->refusal(), Refusal::kLost);
  EXPECT_THAT(std::string(world.loop->reconnect_status().message()), HasSubstr("nobody listens"));
}

TEST(BridgeSafety, ADriverThatIsStartedAgainGoesOnAfterClearAndEnable) {
  BridgeWorld world;
  After("dies", world, [&] { world.driver->HangUp(); });
  const ArmVector left = world.driver->position;
  world.StartDriver();
  world.driver->position = world.driver->target = left;
  world.driver->position[2] = world.driver->target[2] = left[2] - 0.7;  // it sank meanwhile
  world.Ticks(30);
  EXPECT_EQ(world.loop->state(), ClientState::kFault) << "nothing comes back by itself";
  EXPECT_FALSE(world.driver->greeted);
  const uint64_t before = world.arm->Latest().sequence;
  world.Tick(kRequestClear);
  ASSERT_EQ(world.loop->state(), ClientState::kIdle) << world.loop->reconnect_status();
  EXPECT_GT(world.arm->Latest().sequence, before);
  EXPECT_EQ(world.arm->Latest().faults, 0u);
  world.Ticks(30);
  EXPECT_EQ(world.driver->enables + world.driver->commands, 0) << "nothing moves by itself";
  world.Tick(kRequestEnable);
  ASSERT_EQ(world.loop->state(), ClientState::kEnabled) << world.loop->enable_status();
  world.Ticks(10);
  EXPECT_NEAR(world.driver->position[2], left[2] - 0.7, 1e-3) << "it holds where it stands";
  world.Tick(kRequestStart);
  world.Ticks(30);
  EXPECT_EQ(world.loop->state(), ClientState::kRun);
  EXPECT_GT(world.driver->position[0], left[0] + 0.1);
}

TEST(BridgeSafety, InIdleEnableConnectsAgain) {
  BridgeWorld world;
  world.Open();
  world.Ticks(3);
  world.driver->HangUp();
  world.Ticks(3);
  world.Tick(kRequestEnable);
  EXPECT_EQ(world.loop->state(), ClientState::kIdle);
  EXPECT_THAT(std::string(world.loop->enable_status().message()), HasSubstr("nobody listens"));
  world.StartDriver();
  world.Tick(kRequestEnable);
  EXPECT_EQ(world.loop->state(), ClientState::kEnabled) << world.loop->enable_status();
}

TEST(BridgeSafety, AnotherDriverOrAnotherArmIsNoRepair) {
  const auto refused = [](const std::function<void(BridgeWorld&)>& change) {
    BridgeWorld world;
    After("dies", world, [&] { world.driver->HangUp(); });
    world.StartDriver();
    change(world);
    world.Tick(kRequestClear);
    EXPECT_EQ(world.loop->state(), ClientState::kFault);
    world.Ticks(5);
    EXPECT_EQ(world.driver->enables + world.driver->commands, 0);
    EXPECT_EQ(world.arm->Latest().faults & kFaultBus, kFaultBus);
    EXPECT_FALSE(world.arm->Disable().ok());
    const std::string said(world.loop->reconnect_status().message());
    // The right one afterwards is one.
    world.StartDriver();
    world.Tick(kRequestClear);
    EXPECT_EQ(world.loop->state(), ClientState::kIdle) << world.loop->reconnect_status();
    return said;
  };
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->welcome["robot"] = "six servos"; }),
              HasSubstr("it drives 'six servos', the one before 'five servos'"));
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->welcome["stop"] = false; }),
              HasSubstr("another driver answers"));
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->welcome["watchdog_s"] = 0.4; }),
              HasSubstr("another driver answers"));
  EXPECT_THAT(refused([](BridgeWorld& w) {
                w.driver->welcome["axes"] = {"lift", "pan", "elbow", "flex", "roll", "jaw"};
              }),
              HasSubstr("correct the names"));
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->silent = true; }),
              HasSubstr("no state of the arm within 1 s"));
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->reads = false; }),
              HasSubstr("no welcome within 1 s"));
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->Write("what is this", 12); }),
              HasSubstr("instead of a welcome"));
  EXPECT_THAT(refused([](BridgeWorld& w) { w.driver->stamp_back_ns = 2'000'000'000; }),
              HasSubstr("s behind this machine's CLOCK_MONOTONIC"));
}

TEST(BridgeSafety, AStopEndsTheWaitForADriverThatDoesNotAnswer) {
  BridgeWorld world;
  std::atomic<int> presses{0};
  After("dies", world, [&] { world.driver->HangUp(); });
  world.loop->ObeyStops(&presses);
  world.StartDriver();
  world.driver->reads = false;
  world.loop->Ask(kRequestClear);
  world.clock.on_turn = [&] { ++presses; };
  const int64_t before = world.clock.now_ns();
  world.Tick();
  EXPECT_LT(world.clock.now_ns() - before, 200'000'000);
  EXPECT_EQ(world.loop->reconnect_status().code(), absl::StatusCode::kCancelled);
}

TEST(BridgeSafety, AFaultOfTheArmStaysOneAfterANewConnection) {
  BridgeWorld world;
  After("dies", world, [&] { world.driver->HangUp(); });
  world.StartDriver();
  world.driver->faults = kFaultCollision;
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kFault);
  EXPECT_EQ(world.loop->refusal(), Refusal::kFaults);
  EXPECT_EQ(world.arm->Latest().faults, kFaultCollision);
  world.driver->faults = 0;
  world.Ticks(3);
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kIdle) << "it is connected already";
}

TEST(BridgeSafety, AFrozenDriverHoldsThenFaults) {
  BridgeWorld world;
  const Ended ended = After("freezes", world, [&] { world.clock.driver = nullptr; });
  EXPECT_EQ(ended.state, ClientState::kHold);
  EXPECT_EQ(ended.cause, StateCause::kArmSilent);
  EXPECT_LE(ended.seconds, 0.1);
  EXPECT_LE(world.SecondsUntilLeft(ClientState::kHold), 0.3);
  EXPECT_EQ(world.loop->state(), ClientState::kFault);
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kFault);
  EXPECT_EQ(world.loop->refusal(), Refusal::kStale);
}

TEST(BridgeSafety, StatesThatStopComeLateOrAgainHold) {
  for (const auto& [name, act] :
       std::vector<std::pair<const char*, std::function<void(BridgeWorld&)>>>{
           {"silent", [](BridgeWorld& w) { w.driver->silent = true; }},
           {"replays", [](BridgeWorld& w) { w.driver->frozen_sequence = true; }},
           {"late by 300 ms", [](BridgeWorld& w) { w.driver->stamp_back_ns = 300'000'000; }},
           {"stamps of a time to come",
            [](BridgeWorld& w) { w.driver->stamp_back_ns = -400'000'000; }},
           {"jumps", [](BridgeWorld& w) { w.driver->shift = 0.5; }}}) {
    BridgeWorld world;
    const Ended ended = After(name, world, [&] { act(world); });
    EXPECT_EQ(ended.state, ClientState::kHold) << name;
    EXPECT_EQ(ended.cause, StateCause::kArmSilent) << name;
    EXPECT_LE(ended.seconds, 0.11) << name;
    world.Ticks(20);
    EXPECT_EQ(world.loop->state(), ClientState::kFault) << name;
    ExpectStands(world);
  }
}

TEST(BridgeSafety, ValuesThatAreNoNumbersFault) {
  BridgeWorld world;
  const Ended ended = After("NaN", world, [&] { world.driver->nan = true; });
  EXPECT_EQ(ended.state, ClientState::kFault);
  EXPECT_EQ(ended.faults, kFaultDriver);
  EXPECT_LE(ended.seconds, 0.034);
}

TEST(BridgeSafety, BytesThatAreNoFrameEndTheConnection) {
  for (const char* name : {"garbage", "another version", "a value too few", "a second greeting"}) {
    BridgeWorld world;
    const Ended ended = After(name, world, [&] {
      if (name == std::string("garbage")) return world.driver->Write("what is this", 12);
      if (name == std::string("a second greeting"))
        return world.driver->WriteText(FrameKind::kWelcome, world.driver->welcome.dump());
      std::array<uint8_t, kMostFrame> bytes;
      StateFrame state = world.driver->State(world.clock.now_ns());
      if (name == std::string("a value too few")) state.axes = 5;
      const size_t size = EncodeState(state, ++world.driver->sequence, bytes);
      if (name == std::string("another version")) bytes[4] = 2;
      world.driver->Write(bytes.data(), size);
    });
    EXPECT_EQ(ended.state, ClientState::kFault) << name;
    EXPECT_EQ(ended.faults & kFaultBus, kFaultBus) << name;
    EXPECT_LE(ended.seconds, 0.034) << name;
  }
}

TEST(BridgeSafety, ADriverThatHeldByItselfIsAFault) {
  BridgeWorld world;
  const Ended ended = After("its watchdog held", world, [&] { world.driver->taking = false; });
  EXPECT_EQ(ended.state, ClientState::kFault);
  EXPECT_EQ(ended.faults, kFaultMode);
  world.Ticks(10);
  const int commands = world.driver->commands;
  world.Ticks(10);
  EXPECT_EQ(world.driver->commands, commands) << "nothing is commanded in FAULT";
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kIdle);
  world.Tick(kRequestEnable);
  EXPECT_EQ(world.loop->state(), ClientState::kEnabled) << world.loop->enable_status();
}

TEST(BridgeSafety, FaultsOfTheArmFault) {
  BridgeWorld world;
  const Ended ended = After("collision", world, [&] { world.driver->faults = kFaultCollision; });
  EXPECT_EQ(ended.state, ClientState::kFault);
  EXPECT_EQ(ended.faults, kFaultCollision);
  BridgeWorld unknown;
  EXPECT_EQ(After("an unknown bit", unknown, [&] { unknown.driver->faults = 1u << 30; }).faults,
            kFaultOther);
  BridgeWorld power;
  const Ended lost = After("no power", power, [&] { power.driver->powered = false; });
  EXPECT_EQ(lost.cause, StateCause::kArmDisabled);
}

TEST(BridgeSafety, AJointThatCannotMoveIsHeldAndLetGo) {
  BridgeWorld world;
  const Ended ended = After("blocked", world, [&] { world.driver->blocked = true; });
  EXPECT_EQ(ended.state, ClientState::kHold);
  EXPECT_EQ(ended.cause, StateCause::kBlocked);
  EXPECT_LE(ended.seconds, 1.5);
  world.Ticks(3);
  EXPECT_NEAR(world.driver->target[0], world.driver->position[0], 0.03) << "it presses no more";
}

TEST(BridgeSafety, MeasurementsThatLagAreHeld) {
  BridgeWorld world;
  world.Open();
  // What the arm does reaches the measurement 0.3 s later, with fresh stamps.
  std::vector<ArmVector> history;
  world.Tick(kRequestEnable);
  world.Tick(kRequestStart);
  const auto lagging = [&] {
    history.push_back(world.driver->target);
    const size_t back = 9;
    if (history.size() > back) world.driver->position = history[history.size() - 1 - back];
  };
  world.driver->blocked = true;
  bool held = false;
  for (int i = 0; i < 150 && !held; ++i) {
    lagging();
    world.Tick();
    held = world.loop->state() == ClientState::kHold;
  }
  EXPECT_TRUE(held);
  std::printf("measurements 0.3 s late: HOLD (%s)\n", CauseName(world.loop->cause()));
}

TEST(BridgeSafety, StopIsObeyedAndRepeated) {
  BridgeWorld world;
  const Ended ended = After("stop", world, [&] { world.loop->Ask(kRequestQuickStop); });
  EXPECT_EQ(ended.cause, StateCause::kQuickStop);
  EXPECT_LE(ended.seconds, 0.034);
  world.Ticks(60);
  EXPECT_GE(world.driver->stops, 30);
  EXPECT_EQ(world.arm->Latest().faults, 0u);
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kIdle);
  world.Tick(kRequestEnable);
  EXPECT_EQ(world.loop->state(), ClientState::kEnabled) << world.loop->enable_status();
}

TEST(BridgeSafety, ADriverThatDoesNotStopIsShown) {
  BridgeWorld world;
  world.driver->obeys_stop = false;
  const Ended ended = After("does not stop", world, [&] { world.loop->Ask(kRequestQuickStop); });
  EXPECT_EQ(ended.cause, StateCause::kQuickStop);
  world.Ticks(20);
  EXPECT_EQ(world.arm->Latest().faults, kFaultNotStopped);
  world.Tick(kRequestClear);
  EXPECT_EQ(world.loop->state(), ClientState::kFault);
}

TEST(BridgeSafety, ADriverThatSaysItStoppedAndMovesIsShown) {
  BridgeWorld world;
  world.driver->lies = true;
  After("says it stops", world, [&] { world.loop->Ask(kRequestQuickStop); });
  for (int i = 0; i < 60; ++i) {
    world.driver->target[0] = world.driver->position[0] + 0.02;
    world.Tick();
  }
  EXPECT_EQ(world.arm->Latest().faults, kFaultNotStopped);
}

TEST(BridgeSafety, AFloodDelaysNoTick) {
  BridgeWorld world;
  world.driver->floods = 400;
  world.Open();
  world.Tick(kRequestEnable);
  world.Ticks(30);
  EXPECT_NE(world.loop->state(), ClientState::kIdle);
  ExpectStands(world);
}

TEST(BridgeSafety, TheLastOfSevenJointsIsWatchedAsTheFirst) {
  for (const auto& [name, act, state, cause] : std::vector<
           std::tuple<const char*, std::function<void(BridgeWorld&)>, ClientState, StateCause>>{
           {"J7 jumps",
            [](BridgeWorld& w) {
              w.driver->shifted = 6;
              w.driver->shift = 0.5;
            },
            ClientState::kHold, StateCause::kArmSilent},
           {"J7 is no number", [](BridgeWorld& w) { w.driver->nan = true; }, ClientState::kFault,
            StateCause::kArmFault},
           {"J7 is blocked", [](BridgeWorld& w) { w.driver->blocked = true; }, ClientState::kHold,
            StateCause::kBlocked}}) {
    BridgeWorld world(SevenJoints());
    world.moved = 6;
    const Ended ended = After(name, world, [&act = act, &world] { act(world); });
    EXPECT_EQ(ended.state, state) << name;
    EXPECT_EQ(ended.cause, cause) << name;
  }
  BridgeWorld world(SevenJoints());
  world.moved = 6;
  world.Open();
  world.Run();
  const double before = world.driver->position[6];
  world.Ticks(30);
  EXPECT_GT(world.driver->position[6], before + 0.1);
  EXPECT_NEAR(world.driver->last.position[7], 0.02, 1e-9) << "the gripper stays";
}

TEST(BridgeSafety, AStopThatTheLastJointDoesNotObeyIsShown) {
  BridgeWorld world(SevenJoints());
  world.driver->lies = true;
  After("says it stops", world, [&] { world.loop->Ask(kRequestQuickStop); });
  for (int i = 0; i < 60; ++i) {
    world.driver->target[6] = world.driver->position[6] + 0.02;
    world.Tick();
  }
  EXPECT_EQ(world.arm->Latest().faults, kFaultNotStopped);
}

TEST(BridgeSafety, NoCommandIsBeyondTheRobotFilesLimits) {
  BridgeWorld world;
  world.speed = 3;
  ControlOptions options;
  options.limits.joint_velocity = 3;
  options.limits.joint_acceleration = 30;
  options.guards = true;
  world.Open(options);
  world.Tick(kRequestEnable);
  world.Tick(kRequestStart);
  double last = world.driver->target[0], fastest = 0, furthest = 0;
  for (int i = 0; i < 90; ++i) {
    world.Tick();
    fastest = std::max(fastest, std::abs(world.driver->target[0] - last) * 30);
    last = world.driver->target[0];
    furthest = std::max(furthest, last);
  }
  EXPECT_LE(fastest, 2.0 + 1e-6);
  EXPECT_LE(furthest, 1.8);
  EXPECT_GT(furthest, 1.7) << "it was wanted further";
}

}  // namespace
}  // namespace robostress::bridge
