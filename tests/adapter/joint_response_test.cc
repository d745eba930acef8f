#include "adapter/joint_response.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "adapter/disturbance_observer.h"

namespace robostress {
namespace {

using Joints = JointResponse::Joints;
using testing::HasSubstr;

constexpr double kTick_s = 1.0 / 30;

JointResponseOptions Servo() {
  return {.delay_s = {0.06}, .stiffness = {400}, .damping = {20}, .drag = {30}};
}

double Target(double t) { return 0.3 * std::sin(2 * t) + 0.1 * std::sin(7 * t); }

// The equation in steps of 10 us, from rest; targets are held over ticks of `tick_s`.
double Reference(const JointResponseOptions& o, double end_s, double tick_s) {
  constexpr double h = 1e-5;
  double q = 0, v = 0;
  for (int i = 0; i < static_cast<int>(std::lround(end_s / h)); ++i) {
    const double at = i * h - o.delay_s[0] + 1e-9;
    const double u = at < 0 ? 0 : Target(std::floor(at / tick_s) * tick_s);
    v += h * (o.stiffness[0] * (u - q) - o.damping[0] * v - o.drag[0] * std::abs(v) * v);
    q += h * v;
  }
  return q;
}

TEST(JointResponse, SolvesItsEquation) {
  const JointResponseOptions options = Servo();
  JointResponse response(options);
  response.Reset(Joints::Zero(6));
  for (int tick = 0; tick < 90; ++tick) {
    response.Advance(Joints::Constant(6, Target(tick * kTick_s)), kTick_s);
    if (tick % 30 != 29) continue;
    EXPECT_NEAR(response.position()[4], Reference(options, (tick + 1) * kTick_s, kTick_s), 1e-3)
        << tick;
  }
}

TEST(JointResponse, DependsOnWhenTargetsCameNotOnHowOftenItIsAsked) {
  JointResponse once(Servo()), often(Servo());
  once.Reset(Joints::Zero(2));
  often.Reset(Joints::Zero(2));
  for (int tick = 0; tick < 60; ++tick) {
    const Joints target = Joints::Constant(2, Target(tick * kTick_s));
    once.Advance(target, kTick_s);
    for (const double share : {0.2, 0.0, 0.3, -1.0, 0.5}) often.Advance(target, share * kTick_s);
    EXPECT_NEAR(once.position()[0], often.position()[0], 2e-4);
  }
}

TEST(JointResponse, IsBehindByItsDelayDampingAndDrag) {
  JointResponse response(Servo());
  response.Reset(Joints::Zero(1));
  const double speed = 0.5;
  double target = 0;
  for (int tick = 0; tick < 300; ++tick) {
    target = speed * tick * kTick_s;
    response.Advance(Joints::Constant(1, target), kTick_s);
  }
  // A target is held over its tick: half a tick later on average, and read at the tick's end.
  const double lag = target + 0.5 * speed * kTick_s - response.position()[0];
  EXPECT_NEAR(lag, 0.06 * speed + (20 * speed + 30 * speed * speed) / 400, 1e-3);
}

TEST(JointResponse, SaysWhatDoesNotHold) {
  const auto error = [](const JointResponseOptions& o) {
    return std::string(o.Check(6).message());
  };
  EXPECT_EQ(error({}), "");
  EXPECT_EQ(error(Servo()), "");
  JointResponseOptions o = Servo();
  o.drag = {1, 2};
  EXPECT_EQ(error(o), "response.drag has 2 values, must have 1 or 6");
  o = Servo();
  o.delay_s = {0.31};
  EXPECT_THAT(error(o), HasSubstr("response.delay_s has 0.31, must be 0 to 0.3"));
  o.delay_s = {std::nan("")};
  EXPECT_THAT(error(o), HasSubstr("response.delay_s has nan"));
  o.delay_s = {};
  EXPECT_THAT(error(o), HasSubstr("delay_s is empty, so stiffness"));
}

// A healthy arm with an offset from somewhere else, led by the observer.
struct Led {
  double offset = 0, largest = 0, behind = 0, estimate = 0;
};
Led Lead(const DisturbanceObserverOptions& options, double offset) {
  DisturbanceObserver observer(options);
  JointResponse arm(Servo()), healthy(Servo());
  arm.Reset(Joints::Zero(1));
  healthy.Reset(Joints::Zero(1));
  Led led;
  Joints q = Joints::Constant(1, offset);
  for (int tick = 0; tick < 300; ++tick) {
    const Joints target = Joints::Constant(1, Target(tick * kTick_s));
    // Every fifth measurement is lost.
    const bool lost = tick % 5 == 4, after = tick % 5 == 0 && tick > 0;
    const Joints sent = lost ? observer.CorrectUnmeasured(target, kTick_s)
                             : observer.Correct(target, q, after ? 2 * kTick_s : kTick_s);
    led.largest = std::max(led.largest, std::abs(sent[0] - target[0]));
    arm.Advance(sent, kTick_s);
    healthy.Advance(target, kTick_s);
    q = arm.position() + Joints::Constant(1, offset);
    led.behind = std::abs(q[0] - healthy.position()[0]);
  }
  led.estimate = observer.estimate()[0];
  return led;
}

TEST(DisturbanceObserver, AroundAResponseCountsNoLag) {
  DisturbanceObserverOptions options;
  EXPECT_GT(Lead(options, 0).largest, 0.02) << "the paper's, whose servo does not lag";
  options.response = Servo();
  EXPECT_LT(Lead(options, 0).largest, 1e-12);
}

TEST(DisturbanceObserver, AroundAResponseLeadsTheArmToWhereAHealthyOneIs) {
  DisturbanceObserverOptions options;
  options.response = Servo();
  const Led led = Lead(options, 0.03);
  EXPECT_LT(led.behind, 1e-3);
  EXPECT_NEAR(led.estimate, 0.03, 1e-3);
}

TEST(DisturbanceObserver, BeginsAnEpisodeWithANewResponse) {
  DisturbanceObserverOptions options;
  options.response = Servo();
  DisturbanceObserver observer(options), fresh(options);
  for (int tick = 0; tick < 30; ++tick)
    observer.Correct(Joints::Constant(1, Target(tick * kTick_s)), Joints::Zero(1), kTick_s);
  observer.Reset();
  const Joints rest = Joints::Constant(1, 0.2);
  for (DisturbanceObserver* o : {&observer, &fresh}) {
    o->CorrectUnmeasured(rest, kTick_s);
    o->Correct(rest, rest, kTick_s);
    o->Correct(rest, rest, kTick_s);
  }
  EXPECT_EQ(observer.estimate(), fresh.estimate());
  EXPECT_NEAR(observer.estimate()[0], 0, 1e-12);
}

}  // namespace
}  // namespace robostress
