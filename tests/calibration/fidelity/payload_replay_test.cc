#include "calibration/fidelity/payload_replay.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;

// 0 to 4 s at 10 Hz, moving at 1 m/s along x, held within [1, 3] s.
Replay Straight() {
  Replay replay;
  for (int i = 0; i <= 40; ++i) {
    replay.t.push_back(0.1 * i);
    replay.p.emplace_back(0.1 * i, 0, 0);
    replay.held.push_back(i >= 10 && i <= 30);
  }
  return replay;
}

TEST(FindGrasp, TakesTheLongestStretch) {
  Replay replay = Straight();
  replay.held[3] = true;  // a touch on the way
  const GraspSpan span = FindGrasp(replay).value();
  EXPECT_DOUBLE_EQ(span.grasp, 1);
  EXPECT_DOUBLE_EQ(span.release, 3);
  EXPECT_DOUBLE_EQ(span.end, 4);
}

TEST(FindGrasp, RefusesAReplayWithoutGraspOrReach) {
  Replay replay = Straight();
  replay.held.assign(replay.held.size(), false);
  EXPECT_THAT(std::string(FindGrasp(replay).status().message()), HasSubstr("nothing is held"));
  replay.held.assign(replay.held.size(), true);
  EXPECT_THAT(std::string(FindGrasp(replay).status().message()), HasSubstr("from the start"));
}

TEST(AtPhases, GoesThroughStartGraspAndRelease) {
  const Replay replay = Straight();
  const auto path = AtPhases(replay, FindGrasp(replay).value());
  EXPECT_NEAR(path[0].x(), 0, 1e-12);
  EXPECT_NEAR(path[kPhasesBefore].x(), 1, 1e-12);
  EXPECT_NEAR(path[kPhases - 1].x(), 3, 1e-12);
  EXPECT_NEAR(path[kPhasesBefore / 2].x(), 0.5, 1e-12);
  EXPECT_NEAR(path[kPhasesBefore + (kPhases - 1 - kPhasesBefore) / 2].x(), 2, 1e-12);
}

TEST(AtPhases, HoldsTheLastRowOfAShorterReplay) {
  Replay replay = Straight();
  const GraspSpan span = FindGrasp(replay).value();
  replay.t.resize(21), replay.p.resize(21), replay.held.resize(21);
  EXPECT_NEAR(AtPhases(replay, span).back().x(), 2, 1e-12);
}

TEST(Deviation, IsTheDistanceAtEqualTimes) {
  const Replay replay = Straight();
  const auto path = AtPhases(replay, FindGrasp(replay).value());
  auto moved = path;
  for (auto& p : moved) p += Eigen::Vector3d(0, 3e-3, -4e-3);
  for (const double d : Deviation(moved, path)) EXPECT_NEAR(d, 5e-3, 1e-12);
}

TEST(Rise, IsTheStepOfAStep) {
  Profile step(kPhases);
  for (int i = 0; i < kPhases; ++i) step[i] = PhaseAt(i) < 0 ? 1e-3 : 7e-3;
  EXPECT_NEAR(Rise(step), 6e-3, 1e-12);
}

TEST(Spread, IsTheSampleDeviation) {
  const Profile low(kPhases, 1), high(kPhases, 3);
  EXPECT_NEAR(Spread({low, high})[7], std::sqrt(2.0), 1e-12);
  EXPECT_EQ(Spread({low})[7], 0);
  EXPECT_EQ(Mean({low, high})[7], 2);
}

}  // namespace
}  // namespace robostress::calibration
