#include "robot_client/control/command_limiter.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>

namespace robostress {
namespace {

constexpr double kPeriod = 1.0 / 30;

ArmLimits Box() {
  ArmLimits limits;
  limits.lower.fill(-1);
  limits.upper.fill(1);
  limits.lower[6] = 0;
  limits.upper[6] = 0.07;
  limits.max_velocity.fill(3);
  limits.max_acceleration.fill(10);
  return limits;
}

CommandLimiter Limiter(const LimiterOptions& options = {}) {
  CommandLimiter limiter;
  EXPECT_TRUE(limiter.Configure(options, Box(), kPeriod).ok());
  limiter.Reset({});
  return limiter;
}

ArmVector AllJoints(double value) {
  ArmVector v{};
  std::fill_n(v.begin(), ArmAxes().joints, value);
  return v;
}

TEST(CommandLimiterTest, BrakingSpeedStopsExactlyAtTheGap) {
  for (const double gap : {1e-6, 1e-3, 0.0055, 0.02, 0.3, 2.0}) {
    double w = BrakingSpeed(gap, 5, kPeriod), covered = 0;
    for (; w > 0; w -= 5 * kPeriod) covered += w * kPeriod;
    EXPECT_NEAR(covered, gap, 1e-12);
  }
  EXPECT_EQ(BrakingSpeed(0, 5, kPeriod), 0);
  EXPECT_EQ(BrakingSpeed(-1, 5, kPeriod), 0);
}

TEST(CommandLimiterTest, FollowsAReachableMotionExactly) {
  CommandLimiter limiter = Limiter();
  double worst = 0;
  for (int i = 0; i < 600; ++i) {  // 0.5 rad at 0.2 Hz: 0.63 rad/s, 0.8 rad/s^2
    const double target = 0.5 * (1 - std::cos(2 * M_PI * 0.2 * i * kPeriod)) / 2;
    const ArmVector sent = limiter.Limit(AllJoints(target));
    worst = std::max(worst, std::abs(sent[0] - target));
    EXPECT_EQ(limiter.flags(), 0) << i;
  }
  EXPECT_LT(worst, 1e-12);
}

TEST(CommandLimiterTest, AStepIsReachedWithoutOvershoot) {
  CommandLimiter limiter = Limiter();
  double peak = 0;
  for (int i = 0; i < 60; ++i) peak = std::max(peak, limiter.Limit(AllJoints(0.6))[2]);
  EXPECT_LE(peak, 0.6 + 1e-12);
  EXPECT_NEAR(limiter.position()[2], 0.6, 1e-9);
  EXPECT_TRUE(limiter.at_rest());
}

// Whatever is asked for, every command keeps every bound.
TEST(CommandLimiterTest, NeverExceedsABoundUnderRandomTargets) {
  const LimiterOptions options;
  CommandLimiter limiter = Limiter(options);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> anywhere(-4, 4), small(-0.03, 0.03);
  ArmVector target{}, before = limiter.position(), speed_before{}, acceleration_before{};
  for (int i = 0; i < 30000; ++i) {
    for (int a = 0; a < ArmAxes().count(); ++a) {
      const uint32_t kind = random() % 20;
      if (kind == 0) target[a] = anywhere(random);
      if (kind > 10) target[a] += small(random);
      if (kind == 1) target[a] = std::numeric_limits<double>::quiet_NaN();
      if (!std::isfinite(target[a]) && kind == 2) target[a] = 0;
    }
    const ArmVector sent = i % 97 == 0 ? limiter.Decelerate() : limiter.Limit(target);
    for (int a = 0; a < ArmAxes().count(); ++a) {
      const bool joint = a < ArmAxes().joints;
      const double v = (sent[a] - before[a]) / kPeriod;
      const double lower = joint ? -1 + options.joint_margin : 0;
      const double upper = joint ? 1 - options.joint_margin : 0.07;
      ASSERT_GE(sent[a], lower - 1e-9);
      ASSERT_LE(sent[a], upper + 1e-9);
      ASSERT_LE(std::abs(v), (joint ? options.joint_velocity : options.gripper_velocity) + 1e-9);
      ASSERT_LE(std::abs(sent[a] - before[a]),
                (joint ? options.joint_step : options.gripper_step) + 1e-9);
      ASSERT_LE(
          std::abs(v - speed_before[a]),
          (joint ? options.joint_acceleration : options.gripper_acceleration) * kPeriod + 1e-9)
          << "axis " << a << " tick " << i;
      const double acceleration = (v - speed_before[a]) / kPeriod;
      if (joint) {
        ASSERT_LE(std::abs(acceleration - acceleration_before[a]),
                  options.joint_jerk * kPeriod + 1e-6)
            << "axis " << a << " tick " << i;
      }
      acceleration_before[a] = acceleration;
      speed_before[a] = v;
    }
    before = sent;
  }
}

TEST(CommandLimiterTest, DeceleratesToRestAtTheAccelerationLimit) {
  CommandLimiter limiter = Limiter();
  double target = 0;
  for (int i = 0; i < 30; ++i) limiter.Limit(AllJoints(target += 0.8 * kPeriod));
  ASSERT_NEAR(limiter.velocity()[0], 0.8, 1e-9);
  const double from = limiter.position()[0];
  int ticks = 0;
  while (!limiter.at_rest()) {
    limiter.Decelerate();
    ASSERT_LT(++ticks, 20);
  }
  // 0.8 rad/s at 5 rad/s^2 takes 4.8 ticks, and 50 rad/s^3 takes 3 to get there and 3 back.
  EXPECT_LE(ticks, 9);
  EXPECT_LT(limiter.position()[0] - from, 0.8 * 0.8 / (2 * 5) + 0.8 * 0.1);
}

TEST(CommandLimiterTest, WithoutABoundOnJerkItBrakesAtOnce) {
  CommandLimiter limiter = Limiter({.joint_jerk = std::numeric_limits<double>::infinity()});
  double target = 0;
  while (limiter.velocity()[0] < 0.8 - 1e-9) limiter.Limit(AllJoints(target += 0.8 * kPeriod));
  int ticks = 0;
  for (; !limiter.at_rest(); ++ticks) limiter.Decelerate();
  EXPECT_EQ(ticks, 5);
}

TEST(CommandLimiterTest, AJointThatTurnsBackIsNotAtRest) {
  CommandLimiter limiter = Limiter();
  for (int i = 0; i < 4; ++i) limiter.Limit(AllJoints(0.9));
  for (int i = 0; i < 20 && limiter.velocity()[0] > 1e-6; ++i) limiter.Limit(AllJoints(-0.9));
  ASSERT_NEAR(limiter.velocity()[0], 0, 1e-9) << "after whole ticks of 5 rad/s^2";
  ASSERT_LT(limiter.acceleration()[0], -4);
  EXPECT_FALSE(limiter.at_rest());
  const double turned = limiter.position()[0];
  for (int i = 0; i < 20; ++i) limiter.Decelerate();
  EXPECT_LT(limiter.position()[0], turned - 0.01) << "it goes on while it lets go";
  EXPECT_TRUE(limiter.at_rest());
}

// Moved about at random and let go at any moment, it rests within the ticks that it says.
TEST(CommandLimiterTest, BrakesWithinTheTicksThatItSays) {
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  const LimiterOptions kinds[] = {{},
                                  {.joint_velocity = 3},
                                  {.joint_velocity = 0.1},
                                  {.joint_acceleration = 0.5},
                                  {.joint_acceleration = 9, .joint_jerk = 5},
                                  {.joint_velocity = 2, .joint_jerk = kInfinite},
                                  {.gripper_velocity = 0.3, .gripper_acceleration = 0.5}};
  for (const LimiterOptions& options : kinds) {
    for (const double period : {1.0 / 5, 1.0 / 30, 1.0 / 200}) {
      CommandLimiter limiter;
      ASSERT_TRUE(limiter.Configure(options, Box(), period).ok());
      limiter.Reset({});
      std::mt19937 random(4);
      ArmVector target{};
      for (int i = 0; i < 500; ++i) {
        for (int a = 0; a < ArmAxes().count(); ++a) {
          if (random() % 40 == 0)
            target[a] = std::uniform_real_distribution<double>(-1.2, 1.2)(random);
        }
        limiter.Limit(target);
        if (i % 5 != 0) continue;
        CommandLimiter braking = limiter;
        std::array<int, kMostAxes> ticks{};
        for (int k = 1; !braking.at_rest(); ++k) {
          ASSERT_LE(k, 20000);
          braking.Decelerate();
          for (int a = 0; a < ArmAxes().count(); ++a)
            if (std::abs(braking.velocity()[a]) > 1e-6) ticks[a] = k + 1;
        }
        for (int a = 0; a < ArmAxes().count(); ++a)
          ASSERT_LE(ticks[a], limiter.BrakingTicks(a)) << "axis " << a << " period " << period;
      }
    }
  }
  // 1 rad/s at 5 rad/s^2 and 50 rad/s^3 is 0.3 s, after 0.1 s in which it lets go of speeding up.
  EXPECT_NEAR(Limiter().BrakingTicks(0), 15, 1);
}

TEST(CommandLimiterTest, SaysWhichBoundItApplied) {
  CommandLimiter limiter = Limiter();
  limiter.Limit(AllJoints(5));
  EXPECT_EQ(limiter.flags(), kLimitedPosition | kLimitedJerk);
  const auto joints = [](CommandLimiter& limiter, int ticks) {
    ArmVector target = AllJoints(0.5);
    for (int i = 0; i < ticks; ++i) limiter.Limit(target);
    return limiter.flags();
  };
  CommandLimiter full = Limiter();
  EXPECT_EQ(joints(full, 1), kLimitedJerk);
  EXPECT_EQ(joints(full, 2), kLimitedAcceleration);
  CommandLimiter slow = Limiter({.joint_velocity = 0.1});
  EXPECT_EQ(joints(slow, 3), kLimitedVelocity);
  CommandLimiter steps = Limiter({.joint_step = 0.001});
  EXPECT_EQ(joints(steps, 3), kLimitedStep);
}

TEST(CommandLimiterTest, AnArmOutsideTheBoxOnlyMovesInwards) {
  CommandLimiter limiter = Limiter();
  ArmVector outside = AllJoints(1.2);
  limiter.Reset(outside);
  EXPECT_EQ(limiter.Decelerate(), outside) << "holding does not move it";
  double before = 1.2;
  for (int i = 0; i < 100; ++i) {
    const double now = limiter.Limit(AllJoints(2))[0];
    ASSERT_LE(now, before + 1e-9);
    before = now;
  }
  EXPECT_NEAR(before, 0.98, 1e-9) << "a target beyond the box is a target at its edge";
}

TEST(CommandLimiterTest, TheArmsOwnLimitsApplyWhereTheyAreLower) {
  ArmLimits arm = Box();
  arm.max_velocity.fill(0.2);
  CommandLimiter limiter;
  ASSERT_TRUE(limiter.Configure({}, arm, kPeriod).ok());
  limiter.Reset({});
  for (int i = 0; i < 30; ++i) limiter.Limit(AllJoints(0.9));
  EXPECT_NEAR(limiter.velocity()[0], 0.2, 1e-6);
}

TEST(CommandLimiterTest, RefusesLimitsWithoutRoom) {
  ArmLimits arm = Box();
  arm.lower[2] = arm.upper[2] = -0.0017;  // as a corrupted flash was seen to say
  CommandLimiter limiter;
  const absl::Status status = limiter.Configure({}, arm, kPeriod);
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()), ::testing::HasSubstr("J3"));
}

}  // namespace
}  // namespace robostress
