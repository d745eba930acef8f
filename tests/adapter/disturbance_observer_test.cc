#include "adapter/disturbance_observer.h"

#include <gtest/gtest.h>

#include <cmath>

namespace robostress {
namespace {

using Joints = DisturbanceObserver::Joints;

// A servo that settles at its target plus a constant disturbance within one step.
struct BiasedServo {
  double bias;
  Joints q = Joints::Zero(6);
  void Follow(const Joints& target) { q = target + Joints::Constant(6, bias); }
};

TEST(DisturbanceObserver, RemovesAConstantDisturbanceWithItsTimeConstant) {
  DisturbanceObserver observer;
  BiasedServo servo{0.03};
  const Joints reference = Joints::Constant(6, 0.5);
  const double dt = 1.0 / 30;
  for (int i = 0; i < 15; ++i) servo.Follow(observer.Correct(reference, servo.q, dt));
  // z = d (1 - exp(-omega t)) after 14 updates; the first call had nothing to compare with.
  EXPECT_NEAR(observer.estimate()[0], 0.03 * (1 - std::exp(-2.0 * 14 * dt)), 1e-12);
  for (int i = 0; i < 300; ++i) servo.Follow(observer.Correct(reference, servo.q, dt));
  EXPECT_NEAR(servo.q[3], 0.5, 1e-6);
}

TEST(DisturbanceObserver, NeverCorrectsByMoreThanItsLimit) {
  DisturbanceObserver observer;
  BiasedServo servo{0.4};
  const Joints reference = Joints::Constant(6, 0.5);
  Joints sent = reference;
  for (int i = 0; i < 400; ++i) {
    sent = observer.Correct(reference, servo.q, 1.0 / 30);
    servo.Follow(sent);
  }
  EXPECT_NEAR(reference[0] - sent[0], 0.05, 1e-12);
}

TEST(DisturbanceObserver, ClampsTheElapsedTime) {
  const auto estimate_after = [](double dt) {
    DisturbanceObserver observer;
    observer.Correct(Joints::Zero(6), Joints::Zero(6), 0.03);
    observer.Correct(Joints::Zero(6), Joints::Constant(6, 0.01), dt);
    return observer.estimate()[0];
  };
  EXPECT_EQ(estimate_after(5.0), estimate_after(0.2));
  EXPECT_EQ(estimate_after(0.0), estimate_after(0.005));
  EXPECT_LT(estimate_after(0.005), estimate_after(0.2));
}

TEST(DisturbanceObserver, ForgetsEverythingOnReset) {
  DisturbanceObserver observer;
  BiasedServo servo{0.03};
  for (int i = 0; i < 30; ++i) servo.Follow(observer.Correct(Joints::Zero(6), servo.q, 0.03));
  observer.Reset();
  EXPECT_EQ(observer.Correct(Joints::Constant(6, 1), servo.q, 0.03), Joints::Constant(6, 1));
}

// A joint that is blocked for 5 s, then follows again without error.
int TicksUntilRecovered(bool anti_windup) {
  DisturbanceObserver observer({.anti_windup = anti_windup});
  const double dt = 1.0 / 30;
  Joints q = Joints::Zero(1);
  const Joints reference = Joints::Constant(1, 0.3);
  for (int i = 0; i < 150; ++i) observer.Correct(reference, q, dt);
  for (int i = 0; i < 300; ++i) {
    q = observer.Correct(reference, q, dt);
    if (std::abs(q[0] - reference[0]) < 0.05 * 0.05) return i;
  }
  return 300;
}

TEST(DisturbanceObserver, AntiWindupRecoversSoonerFromABlock) {
  const int state = TicksUntilRecovered(true), output = TicksUntilRecovered(false);
  EXPECT_NEAR(state, 45, 2);  // 0.05 exp(-2 t) < 0.0025 after 1.5 s
  EXPECT_GT(output, state + 20);
  EXPECT_LT(output, 300);
}

TEST(DisturbanceObserver, ClipsTheStateOnlyWithAntiWindup) {
  for (const bool anti_windup : {false, true}) {
    DisturbanceObserver observer({.anti_windup = anti_windup});
    for (int i = 0; i < 100; ++i)
      observer.Correct(Joints::Zero(6), Joints::Constant(6, 1.0), 1.0 / 30);
    EXPECT_EQ(observer.estimate()[0] > 0.05, !anti_windup);
  }
}

TEST(DisturbanceObserver, ComparesWithWhatWasReallySent) {
  DisturbanceObserver observer;
  observer.Correct(Joints::Constant(6, 1.0), Joints::Zero(6), 1.0 / 30);
  observer.Applied(Joints::Constant(6, 0.1));  // a limiter held it back
  observer.Correct(Joints::Constant(6, 1.0), Joints::Constant(6, 0.1), 1.0 / 30);
  EXPECT_EQ(observer.estimate()[0], 0) << "the arm did what it was told";
}

TEST(DisturbanceObserver, KeepsItsEstimateWithoutANewMeasurement) {
  DisturbanceObserver observer;
  observer.Correct(Joints::Zero(6), Joints::Zero(6), 1.0 / 30);
  observer.Correct(Joints::Zero(6), Joints::Constant(6, 0.02), 1.0 / 30);
  const double before = observer.estimate()[0];
  EXPECT_EQ(observer.CorrectUnmeasured(Joints::Constant(6, 1))[0], 1 - before);
  EXPECT_EQ(observer.estimate()[0], before);
}

}  // namespace
}  // namespace robostress
