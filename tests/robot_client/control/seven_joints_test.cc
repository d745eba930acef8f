// What the loop does for an arm of seven joints and a gripper: every watch and limit reaches the
// last joint, and none takes the gripper for one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <memory>

#include "common/robot_description.h"
#include "robot_client/control/control_loop.h"
#include "tests/robot_client/answer_to.h"
#include "tests/robot_client/fake_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr int kJ7 = 6, kOpening = 7;
constexpr int64_t kTick_ns = 33'333'333;

RehearsalArmOptions SevenAndGripper() {
  RehearsalArmOptions options;
  options.start = {0, -0.785, 0, -2.356, 0, 1.571, 0.785, 0.04};
  options.limits = {};
  options.limits.axes = {7, true};
  for (int j = 0; j < 7; ++j) {
    options.limits.lower[j] = kPanda.joints[j].lower;
    options.limits.upper[j] = kPanda.joints[j].upper;
    options.limits.max_velocity[j] = kPanda.joints[j].max_velocity;
    options.limits.max_acceleration[j] = 7.5;
  }
  options.limits.upper[kOpening] = 0.08;
  options.limits.max_velocity[kOpening] = 0.1;
  options.limits.max_acceleration[kOpening] = 2;
  return options;
}

ControlOptions OfSeven(ControlOptions options = {}) {
  FitDefaults(7, options.press);
  return options;
}

// A policy that moves J7 at `speed` and wants the gripper at `opening`.
struct SevenBench {
  ManualClock clock{1'000'000'000};
  FakeArm arm{&clock, SevenAndGripper()};
  NoCameras cameras;
  std::unique_ptr<ControlLoop> loop;
  double speed = 0.3, opening = 0.04;

  explicit SevenBench(const ControlOptions& options = OfSeven(), const ArmModel* model = nullptr) {
    EXPECT_TRUE(arm.Connect().ok());
    auto made = ControlLoop::Create(options, &arm, &clock, &cameras, model);
    EXPECT_TRUE(made.ok()) << made.status();
    loop = *std::move(made);
    loop->OnPredictionRequested([this] { Serve(); });
  }
  void Serve() {
    PredictionRequest request;
    while (loop->prediction_requests().Pop(request)) {
      loop->AnswerPrediction(AnswerTo(request, [&](int i) {
        ArmVector target = request.position;
        target[kJ7] += speed * (i + 1) / 30.0;
        target[kOpening] = opening;
        return target;
      }));
    }
  }
  const TickRecord& Tick(uint32_t requests = 0) {
    clock.Advance(kTick_ns);
    if (requests != 0) loop->Ask(requests);
    loop->Tick(clock.now_ns());
    return loop->last_record();
  }
  void Start() {
    Tick(kRequestEnable);
    ASSERT_EQ(loop->state(), ClientState::kEnabled) << loop->enable_status();
    Tick(kRequestStart);
    ASSERT_EQ(loop->state(), ClientState::kRun);
  }
  // Ticks until RUN is left; the cause.
  StateCause Ends(int most = 150) {
    for (int i = 0; i < most && loop->state() == ClientState::kRun; ++i) Tick();
    return loop->state() == ClientState::kRun ? StateCause::kNone : loop->cause();
  }
};

TEST(SevenJoints, APolicyMovesTheLastJointAndTheGripper) {
  SevenBench bench;
  bench.Start();
  for (int i = 0; i < 60; ++i) bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  EXPECT_GT(bench.arm.last.position[kJ7], 0.785 + 0.3);
  EXPECT_EQ(bench.arm.last.position[kOpening], 0.04);
  EXPECT_EQ(bench.loop->last_record().axes.joints, 7);
}

TEST(SevenJoints, TheLastJointHasAJointsLimitsAndTheGripperItsOwn) {
  ControlOptions options = OfSeven();
  options.limits.joint_velocity = 0.5;
  SevenBench bench(options);
  bench.speed = 2;
  bench.opening = 0.08;
  bench.Start();
  ArmVector last = bench.arm.last.position;
  double turned = 0, opened = 0;
  for (int i = 0; i < 90; ++i) {
    bench.Tick();
    turned = std::max(turned, std::abs(bench.arm.last.position[kJ7] - last[kJ7]) * 30);
    opened = std::max(opened, std::abs(bench.arm.last.position[kOpening] - last[kOpening]) * 30);
    last = bench.arm.last.position;
  }
  EXPECT_NEAR(turned, 0.5, 1e-3) << "[rad/s]";
  EXPECT_NEAR(opened, 0.1, 1e-3) << "[m/s]: the arm's limit, below the options'";
  EXPECT_NEAR(last[kOpening], 0.08, 1e-9);
}

TEST(SevenJoints, TheLastJointStopsBeforeItsEnd) {
  SevenBench bench;
  bench.speed = 1;
  bench.Start();
  double furthest = 0;
  for (int i = 0; i < 150; ++i) {
    bench.Tick();
    furthest = std::max(furthest, bench.arm.last.position[kJ7]);
  }
  EXPECT_NEAR(furthest, 2.8973 - 0.02, 1e-6) << "the margin of a joint";
}

TEST(SevenJoints, ALastJointThatIsBlockedIsSeen) {
  SevenBench bench;
  bench.Start();
  for (int i = 0; i < 20; ++i) bench.Tick();
  bench.arm.blocked = true;
  EXPECT_EQ(bench.Ends(), StateCause::kBlocked);
  bench.Tick();
  EXPECT_NEAR(bench.arm.last.position[kJ7], bench.loop->last_record().position[kJ7], 0.03)
      << "let go";
}

TEST(SevenJoints, AGripperThatIsBlockedIsNoJoint) {
  SevenBench bench;
  bench.speed = 0;
  bench.Start();
  bench.arm.blocked = true;
  bench.opening = 0.08;  // 40 mm off are more than control.press.blocked_error of a joint would be
  ControlOptions tight = OfSeven();
  tight.press.blocked_error = tight.watchdogs.following_error = 0.02;
  SevenBench other(tight);
  other.speed = 0;
  other.opening = 0.08;
  other.Start();
  other.arm.blocked = true;
  EXPECT_EQ(other.Ends(), StateCause::kNone) << "holding something is what it is for";
  EXPECT_EQ(bench.Ends(), StateCause::kNone);
}

TEST(SevenJoints, ALastJointThatDoesNotFollowIsSeen) {
  ControlOptions options = OfSeven();
  options.press.blocked_error = 1;
  options.watchdogs.following_error = 0.1;
  options.watchdogs.delay_hold_s = 5;
  SevenBench bench(options);
  bench.Start();
  for (int i = 0; i < 20; ++i) bench.Tick();
  bench.arm.blocked = true;
  // Of every chunk the first rows lead away from where the joint stands.
  bench.speed = 1;
  EXPECT_EQ(bench.Ends(), StateCause::kFollowingError);
}

TEST(SevenJoints, NoLastJointIsSetGoingWhileItMovesOrIsApart) {
  SevenBench bench;
  bench.Tick(kRequestEnable);
  bench.arm.drift = 0.1;
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kMoving);
  SevenBench apart;
  apart.Tick(kRequestEnable);
  apart.arm.blocked = true;
  ArmVector moved = apart.loop->last_record().position;
  apart.arm.blocked_at(kJ7, moved[kJ7] + 0.2);
  apart.Tick(kRequestStart);
  EXPECT_EQ(apart.loop->refusal(), Refusal::kApart);
}

TEST(SevenJoints, ALateChunkFadesInTheLastJointAndSwitchesTheGripper) {
  ChunkPlayer player({}, 7);
  player.StartEpisode(0);
  ArmChunk chunk;
  chunk.rows = 50;
  for (int i = 0; i < 50; ++i) chunk.requested[i] = chunk.policy[i] = {};
  ASSERT_EQ(player.Offer(chunk, 0, {}), ChunkVerdict::kTaken);
  ChunkPlayer::Step step;
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(player.Next(step));
  chunk.chunk = 1;
  for (int i = 0; i < 50; ++i) {
    chunk.requested[i][kJ7] = 0.2;
    chunk.requested[i][kOpening] = 0.05;
  }
  ASSERT_EQ(player.Offer(chunk, 0, {}), ChunkVerdict::kTaken);
  ASSERT_TRUE(player.Next(step));
  EXPECT_TRUE(step.fading);
  EXPECT_LT(step.blended[kJ7], 0.2) << "what would have been played is still in it";
  EXPECT_EQ(step.blended[kOpening], 0.05) << "the gripper switches at once";
  chunk.chunk = 2;
  for (int i = 0; i < 50; ++i) chunk.requested[i][kJ7] = 3;
  EXPECT_EQ(player.Offer(chunk, 0, {}), ChunkVerdict::kJump);
}

TEST(SevenJoints, TheDelayIsEstimatedFromTheLastJointToo) {
  DelayEstimator delay(1.0 / 30, 7);
  ArmVector command{}, measured{};
  for (int tick = 0; tick < 60; ++tick) {
    const auto at = [](int k) { return k < 0 ? 0.0 : 0.5 * std::sin(0.3 * k); };
    command[kJ7] = at(tick);
    measured[kJ7] = at(tick - 5);
    command[kOpening] = tick % 2 == 0 ? 0.08 : 0;  // says nothing about the arm
    delay.Take(command, measured);
  }
  ASSERT_TRUE(delay.delay_s().has_value());
  EXPECT_NEAR(*delay.delay_s(), 6.0 / 30, 0.01);
}

// A joint that sticks answers late and then moves most; a bus that is late makes all of them late.
TEST(SevenJoints, WhatSticksIsNoDelayAndWhatMakesAllLateIs) {
  const auto estimate = [](int first, int second, int third) {
    DelayEstimator delay(1.0 / 30, 7);
    const int late[] = {first, second, third};
    for (int tick = 0; tick < 90; ++tick) {
      ArmVector command{}, measured{};
      for (int j = 0; j < 3; ++j) {
        const double size = j == 0 ? 0.6 : 0.15;
        const auto at = [&](int k) { return k < 0 ? 0 : size * std::sin((0.17 + 0.04 * j) * k); };
        command[j] = at(tick);
        measured[j] = at(tick - late[j]);
      }
      delay.Take(command, measured);
    }
    return delay.delay_s().value_or(-1);
  };
  EXPECT_NEAR(estimate(4, 4, 4), 5.0 / 30, 0.01);
  EXPECT_NEAR(estimate(12, 4, 4), 5.0 / 30, 0.01) << "one sticks";
  EXPECT_NEAR(estimate(9, 9, 9), 10.0 / 30, 0.01) << "all are late";
  EXPECT_NEAR(estimate(14, 9, 9), 10.0 / 30, 0.01) << "all are late, and one sticks";
}

// At constant speed every delay looks alike; where it begins it shows.
TEST(SevenJoints, EvenMotionTellsNoDelay) {
  DelayEstimator delay(1.0 / 30, 7);
  ArmVector command{}, measured{};
  std::optional<double> begun;
  for (int tick = 0; tick < 200; ++tick) {
    command[0] = 0.004 * tick;
    measured[0] = 0.004 * std::max(0, tick - 5) + 2e-5 * (tick % 3);
    delay.Take(command, measured);
    if (tick == 40) begun = delay.delay_s();
  }
  ASSERT_TRUE(begun.has_value());
  EXPECT_NEAR(*begun, 6.0 / 30, 0.02);
  EXPECT_FALSE(delay.delay_s().has_value());
}

// A joint that moves too little alone says nothing, and all together do.
TEST(SevenJoints, LittleMotionOfAllJointsTellsTheirDelay) {
  DelayEstimator delay(1.0 / 30, 7);
  ArmVector command{}, measured{};
  for (int tick = 0; tick < 90; ++tick) {
    for (int j = 0; j < 7; ++j) {
      const auto at = [&](int k) { return k < 0 ? 0 : 0.006 * std::sin((0.2 + 0.02 * j) * k); };
      command[j] = at(tick);
      measured[j] = at(tick - 6);
    }
    delay.Take(command, measured);
  }
  ASSERT_TRUE(delay.delay_s().has_value());
  EXPECT_NEAR(*delay.delay_s(), 7.0 / 30, 0.01);
}

// Knows of no torque at all.
struct WeightlessModel : ArmModel {
  ArmVector Torque(const ArmVector&, const ArmVector&, const ArmVector&, double) const override {
    return {};
  }
  Clearance ClearanceAt(const ArmVector&) const override { return {1, 1, 1}; }
};

TEST(SevenJoints, TorqueOnTheLastJointIsPressing) {
  const WeightlessModel model;
  SevenBench bench(OfSeven(), &model);
  bench.Start();
  for (int i = 0; i < 10; ++i) bench.Tick();
  bench.arm.effort[kOpening] = 50;  // a gripper may hold as hard as it likes
  for (int i = 0; i < 10; ++i) bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  bench.arm.effort[kJ7] = 2.4;
  for (int i = 0; i < 10; ++i) bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kRun) << "below the last value, repeated: 2.5 Nm";
  bench.arm.effort[kJ7] = 2.6;
  EXPECT_EQ(bench.Ends(10), StateCause::kPressing);
  EXPECT_NEAR(bench.loop->last_record().excess[kJ7], 2.6, 1e-12);
}

TEST(SevenJoints, TheDisturbanceObserverCorrectsTheLastJoint) {
  ControlOptions options = OfSeven();
  options.observer = true;
  SevenBench bench(options);
  bench.speed = 0.5;
  bench.Start();
  double most = 0;
  for (int i = 0; i < 60; ++i) {
    const TickRecord& r = bench.Tick();
    most = std::max(most, std::abs(r.corrected[kJ7] - r.blended[kJ7]));
    EXPECT_EQ(r.corrected[kOpening], r.blended[kOpening]);
  }
  EXPECT_GT(most, 0.01);
}

TEST(SevenJoints, OptionsOfAnotherNumberOfJointsAreRefused) {
  ManualClock clock{1'000'000'000};
  FakeArm arm(&clock, SevenAndGripper());
  NoCameras cameras;
  ASSERT_TRUE(arm.Connect().ok());
  const auto refused = [&](const ControlOptions& options) {
    const auto made = ControlLoop::Create(options, &arm, &clock, &cameras, nullptr);
    EXPECT_FALSE(made.ok());
    return std::string(made.status().message());
  };
  EXPECT_THAT(refused({}), HasSubstr("press.excess has 6 numbers, must have one per joint: 7"));
  ControlOptions response = OfSeven();
  response.disturbance_observer.response.delay_s = {0.1, 0.1, 0.1, 0.1, 0.1, 0.1};
  EXPECT_THAT(refused(response), HasSubstr("delay_s has 6 values, must have 1 or 7"));
  ControlOptions given;
  given.press.excess = {1, 2, 3};
  FitDefaults(7, given.press);
  EXPECT_EQ(given.press.excess.size(), 3u) << "what a person gave stays, and is refused";
  EXPECT_EQ(given.press.friction.size(), 7u);
}

TEST(SevenJoints, APoseIsNamedByItsAxis) {
  const ArmLimits limits = SevenAndGripper().limits;
  ArmVector pose = SevenAndGripper().start;
  pose[kJ7] = 3.1;
  EXPECT_THAT(std::string(MoveInside(limits, pose).message()), HasSubstr("J7 stands at 3.1"));
  pose[kJ7] = 0;
  pose[kOpening] = 0.5;
  EXPECT_THAT(std::string(MoveInside(limits, pose).message()), HasSubstr("the gripper stands at"));
}

}  // namespace
}  // namespace robostress
