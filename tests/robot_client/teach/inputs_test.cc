// What a person holds in the hand: keys, a gamepad, a leader arm.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/joystick.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <deque>

#include "robot_client/can/in_process_bus.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/teach/gamepad.h"
#include "robot_client/teach/key_input.h"
#include "robot_client/teach/leader_arm.h"
#include "robot_client/teach/leader_target.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::vector<OperatorCommand> Commands(std::deque<OperatorOrder>& orders) {
  std::vector<OperatorCommand> commands;
  for (const OperatorOrder& order : orders) commands.push_back(order.command);
  orders.clear();
  return commands;
}

TEST(KeyInputTest, KeysMoveTurnAndOrder) {
  ManualClock clock;
  clock.Advance(5'000'000'000);
  KeyInput keys(&clock);
  std::deque<OperatorOrder> orders;
  keys.Take("w", &orders);
  EXPECT_EQ(keys.input().Load().tool[0], 1);
  EXPECT_EQ(keys.input().Load().stamp_ns, clock.now_ns());
  keys.Take("d", &orders);
  EXPECT_EQ(keys.input().Load().tool[1], -1);
  EXPECT_EQ(keys.input().Load().tool[0], 0) << "of two keys the later one counts";
  keys.Take("\x1b[A", &orders);
  EXPECT_EQ(keys.input().Load().tool[0], 1) << "arrow up";
  keys.Take("\x1b[5~", &orders);
  EXPECT_EQ(keys.input().Load().stamp_ns, 0) << "page up means nothing: stop";
  keys.Take("h", &orders);
  EXPECT_EQ(keys.input().Load().gripper, -1);
  EXPECT_TRUE(orders.empty());
  keys.Take("RSFX\x1b\n", &orders);
  EXPECT_THAT(Commands(orders),
              ::testing::ElementsAre(OperatorCommand::kRecord, OperatorCommand::kSuccess,
                                     OperatorCommand::kFailure, OperatorCommand::kDiscard,
                                     OperatorCommand::kHold, OperatorCommand::kHold));
  keys.Take("w?", &orders);
  EXPECT_EQ(keys.input().Load().stamp_ns, 0) << "a key without a meaning stops";
}

TEST(KeyInputTest, JointsAreMovedOneByOne) {
  ManualClock clock;
  clock.Advance(1'000'000'000);
  KeyInput keys(&clock);
  std::deque<OperatorOrder> orders;
  keys.Take("m4s", &orders);
  JogInput input = keys.input().Load();
  EXPECT_TRUE(input.by_joint);
  EXPECT_EQ(input.joint, 3);
  EXPECT_EQ(input.tool[0], -1);
  keys.Take("r", &orders);
  EXPECT_EQ(keys.input().Load().tool[2], 0) << "there is no up for a joint";
  keys.Take("g", &orders);
  EXPECT_EQ(keys.input().Load().gripper, 1);
  keys.Take("mw", &orders);
  EXPECT_FALSE(keys.input().Load().by_joint);
  keys.End();
  EXPECT_TRUE(keys.input().Load().gone);
}

class FakePad : public GamepadFiles {
 public:
  struct State {
    std::deque<js_event> events;
    bool unplugged = false;
    int open_error = 0, opens = 0, closes = 0;
  };
  explicit FakePad(State* state) : state_(state) {}
  int Open(const char*) override {
    ++state_->opens;
    errno = state_->open_error;
    return state_->open_error == 0 ? 7 : -1;
  }
  int Close(int) override {
    ++state_->closes;
    return 0;
  }
  ssize_t Read(int, void* data, size_t size) override {
    if (state_->unplugged) {
      errno = ENODEV;
      return -1;
    }
    if (state_->events.empty()) {
      errno = EAGAIN;
      return -1;
    }
    std::memcpy(data, &state_->events.front(), size);
    state_->events.pop_front();
    return static_cast<ssize_t>(size);
  }
  int Poll(int, int) override { return 1; }

 private:
  State* const state_;
};

js_event Event(int type, int number, int value) {
  js_event event{};
  event.type = static_cast<uint8_t>(type);
  event.number = static_cast<uint8_t>(number);
  event.value = static_cast<int16_t>(value);
  return event;
}

TEST(GamepadTest, NothingMovesUnlessTheDeadMansButtonIsPressedAnew) {
  ManualClock clock;
  clock.Advance(1'000'000'000);
  FakePad::State pad;
  Gamepad gamepad({}, std::make_unique<FakePad>(&pad), &clock);
  ASSERT_TRUE(gamepad.Open().ok());
  pad.events = {Event(JS_EVENT_BUTTON | JS_EVENT_INIT, 4, 1), Event(JS_EVENT_AXIS, 1, -32767)};
  EXPECT_TRUE(gamepad.Poll(0));
  EXPECT_EQ(gamepad.input().Load().tool[0], 0) << "held since before";
  pad.events = {Event(JS_EVENT_BUTTON, 4, 0), Event(JS_EVENT_BUTTON, 4, 1)};
  gamepad.Poll(0);
  EXPECT_NEAR(gamepad.input().Load().tool[0], 1, 1e-12) << "stick pushed away: forwards";
  clock.Advance(400'000'000);
  gamepad.Poll(0);
  EXPECT_EQ(gamepad.input().Load().stamp_ns, clock.now_ns()) << "held without an event";
  pad.events = {Event(JS_EVENT_BUTTON, 4, 0)};
  gamepad.Poll(0);
  EXPECT_EQ(gamepad.input().Load().tool[0], 0);
}

TEST(GamepadTest, AStickHasADeadZoneAndThenItsWholeRange) {
  ManualClock clock;
  FakePad::State pad;
  Gamepad gamepad({}, std::make_unique<FakePad>(&pad), &clock);
  ASSERT_TRUE(gamepad.Open().ok());
  const auto forwards = [&](double share) {
    pad.events = {Event(JS_EVENT_BUTTON, 4, 1),
                  Event(JS_EVENT_AXIS, 1, static_cast<int>(std::lround(-32767 * share)))};
    gamepad.Poll(0);
    return gamepad.input().Load().tool[0];
  };
  EXPECT_EQ(forwards(0.149), 0);
  EXPECT_EQ(forwards(-0.149), 0);
  EXPECT_NEAR(forwards(0.575), 0.5, 1e-4);
  EXPECT_NEAR(forwards(-1), -1, 1e-12);
  pad.events = {Event(JS_EVENT_AXIS, 200, 32767), Event(JS_EVENT_BUTTON, 99, 1)};
  EXPECT_TRUE(gamepad.Poll(0)) << "a pad with more than we know";
}

TEST(GamepadTest, AnUnpluggedPadIsGoneAndAMissingOneSaysWhatToDo) {
  ManualClock clock;
  FakePad::State pad;
  {
    Gamepad gamepad({}, std::make_unique<FakePad>(&pad), &clock);
    ASSERT_TRUE(gamepad.Open().ok());
    pad.events = {Event(JS_EVENT_BUTTON, 4, 1), Event(JS_EVENT_AXIS, 1, -32767)};
    gamepad.Poll(0);
    pad.unplugged = true;
    EXPECT_FALSE(gamepad.Poll(0));
    EXPECT_TRUE(gamepad.input().Load().gone);
    EXPECT_EQ(gamepad.input().Load().tool[0], 0);
    EXPECT_FALSE(gamepad.Poll(0));
  }
  EXPECT_EQ(pad.opens, pad.closes);
  pad.open_error = EACCES;
  Gamepad gamepad({}, std::make_unique<FakePad>(&pad), &clock);
  EXPECT_THAT(std::string(gamepad.Open().message()),
              ::testing::AllOf(HasSubstr("/dev/input/js0"), HasSubstr("group input")));
}

ArmLimits Limits() {
  ArmLimits limits;
  limits.lower.fill(-1);
  limits.upper.fill(1);
  limits.lower[piper::kJoints] = 0;
  limits.upper[piper::kJoints] = 0.07;
  return limits;
}

TEST(LeaderTargetTest, JoinsTheLeaderSlowlyAndThenFollowsItsEveryStep) {
  SnapshotCell<LeaderSample> cell;
  LeaderTarget target(&cell, Limits(), {});
  ArmVector command{};
  target.Begin(command);
  EXPECT_TRUE(target.Silent(0)) << "nothing was heard yet";
  LeaderSample sample;
  sample.position = {0.6, -0.3, 0, 0, 0, 0, 0.02};
  sample.sequence = 1;
  cell.Store(sample);
  int ticks = 0;
  bool joining = true;
  while (joining && ticks < 100) {
    const LiveRow row = target.Next(0, command);
    EXPECT_EQ(row.wanted, sample.position);
    const double step = row.target[0] - command[0];
    if (row.joining) {
      EXPECT_LE(step, 0.6 / 30 + 1e-12);
    }
    EXPECT_NEAR(row.target[1], -0.5 * row.target[0], 1e-9) << "a straight way";
    command = row.target;
    joining = row.joining;
    ++ticks;
  }
  // 0.12 rad of speeding up in 0.4 s, 0.36 rad at 0.6 rad/s, braking but for the last 0.03 rad:
  // 0.6 / 1.5 - sqrt(2 * 0.03 / 1.5) s.
  EXPECT_NEAR(ticks, 30 * (0.4 + 0.6 + 0.2), 3);
  sample.position[0] = 0.65;  // 1.5 rad/s, which the limiter judges
  cell.Store(sample);
  EXPECT_NEAR(target.Next(0, command).target[0], 0.65, 1e-12);
}

TEST(LeaderTargetTest, AJumpIsJoinedAnewAndLimitsAreKept) {
  SnapshotCell<LeaderSample> cell;
  LeaderTarget target(&cell, Limits(), {});
  ArmVector command{};
  target.Begin(command);
  LeaderSample sample;
  sample.sequence = 1;
  cell.Store(sample);
  EXPECT_FALSE(target.Next(0, command).joining);
  sample.position[2] = 0.8;
  cell.Store(sample);
  const LiveRow row = target.Next(0, command);
  EXPECT_TRUE(row.joining);
  EXPECT_NEAR(row.target[2], 1.5 / 30 / 30, 1e-12) << "one tick's speed at 1.5 rad/s^2";
  EXPECT_NEAR(row.wanted[2], 0.8, 1e-12);
  command = {0, 0, 0.95, 0, 0, 0, 0};
  target.Begin(command);
  sample.position[2] = 1.3;  // beyond the follower
  cell.Store(sample);
  for (int i = 0; i < 30; ++i) command = target.Next(0, command).target;
  EXPECT_EQ(command[2], 1);
}

TEST(LeaderTargetTest, ALeaderIsSilentAfterATenthOfASecond) {
  SnapshotCell<LeaderSample> cell;
  LeaderTarget target(&cell, Limits(), {});
  LeaderSample sample;
  sample.sequence = 1;
  sample.stamp_ns = 1'000'000'000;
  cell.Store(sample);
  EXPECT_FALSE(target.Silent(1'099'000'000));
  EXPECT_TRUE(target.Silent(1'101'000'000));
}

TEST(LeaderArmTest, ListensAndNeverSends) {
  ManualClock clock;
  InProcessBus bus(clock);
  auto leader = bus.Attach();
  auto third = bus.Attach();
  ASSERT_TRUE(leader->Open().ok() && third->Open().ok());
  LeaderArm listener(bus.Attach(), &clock);
  EXPECT_THAT(std::string(listener.Connect().message()), HasSubstr("leader mode"));
  const auto say = [&](double angle) {
    for (int pair = 0; pair < 3; ++pair)
      ASSERT_TRUE(leader->Send(piper::EncodeJointTargets({pair, angle, -angle})).ok());
  };
  say(0.5);
  ASSERT_TRUE(leader->Send(piper::Encode(piper::GripperTarget{0.04, 1})).ok());
  say(0.6);
  ASSERT_TRUE(listener.Connect().ok());
  const LeaderSample sample = listener.newest().Load();
  EXPECT_EQ(sample.sequence, 2u);
  EXPECT_NEAR(sample.position[4], 0.6, 1e-5);
  EXPECT_NEAR(sample.position[5], -0.6, 1e-5);
  EXPECT_NEAR(sample.position[piper::kJoints], 0.04, 1e-6);
  ASSERT_TRUE(leader->Send(piper::EncodeJointTargets({0, 1, 1})).ok());
  listener.Poll();
  EXPECT_EQ(listener.newest().Load().sequence, 2u) << "a third of a sample is none";
  StampedFrame heard;
  int frames = 0;
  while (third->Receive(heard)) ++frames;
  EXPECT_EQ(frames, 8) << "all of them the leader's";
}

TEST(LeaderArmTest, SaysWhenTheArmThereIsAFollower) {
  ManualClock clock;
  InProcessBus bus(clock);
  auto arm = bus.Attach();
  LeaderArm listener(bus.Attach(), &clock);
  ASSERT_TRUE(arm->Open().ok());
  EXPECT_FALSE(listener.Connect().ok());
  ASSERT_TRUE(arm->Send(piper::EncodeJointAngles({0, 0, 0})).ok());
  EXPECT_THAT(std::string(listener.Connect().message()), HasSubstr("leads nobody"));
}

}  // namespace
}  // namespace robostress
