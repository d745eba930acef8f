#include "server/proxy/hunting.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "server/proxy/action_block.h"
#include "server/proxy/proxied_arm.h"
#include "tests/server/proxy/proxy_messages.h"
#include "tests/server/proxy/rubbing_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// The answer at which a correction of one column, limited to 1, hunts; -1: it does not.
int HuntsAt(const std::vector<double>& corrections) {
  HuntingWatch watch(Eigen::VectorXd::Ones(1));
  for (size_t i = 0; i < corrections.size(); ++i)
    if (watch.Add(Eigen::VectorXd::Constant(1, corrections[i]))) return static_cast<int>(i);
  return -1;
}

TEST(HuntingWatch, SeesWhatSwingsToAndFro) {
  EXPECT_EQ(HuntsAt({-0.6, 0, -0.6, 0, -0.6, 0}), 4);
  EXPECT_EQ(HuntsAt({0, -0.3, -0.6, -0.3, 0, -0.6, 0, 0, -0.6, 0}), 8);
}

TEST(HuntingWatch, LetsACorrectionGrowTurnAndTremble) {
  EXPECT_EQ(HuntsAt({0, 0.2, 0.4, 0.6, 0.8, 1, 1, 1, 1, 1, 1, 1, 1, 1}), -1);
  EXPECT_EQ(HuntsAt({0.6, 0.2, 0.6, 0.2, 0.6, 0.2, 0.6, 0.2, 0.6, 0.2}), -1) << "less than half";
  std::vector<double> slow;  // an arm that turns every four answers
  for (int i = 0; i < 200; ++i) slow.push_back(i / 4 % 2 == 0 ? 0.9 : -0.9);
  EXPECT_EQ(HuntsAt(slow), -1);
}

TEST(HuntingWatch, EachColumnByItsOwnLimit) {
  HuntingWatch watch(Eigen::Vector2d(1, 0.1));
  std::optional<Eigen::Index> hunts;
  for (int i = 0; i < 5; ++i) hunts = watch.Add(Eigen::Vector2d(0.2, 0.06) * (i % 2));
  EXPECT_FALSE(hunts);
  hunts = watch.Add(Eigen::Vector2d(0.2, 0.06));
  ASSERT_TRUE(hunts);
  EXPECT_EQ(*hunts, 1);
  watch.Reset();
  EXPECT_FALSE(watch.Add(Eigen::Vector2d(0.2, 0.06)));
}

// An arm that moves at once, by 0.7 of what it is told, where the nominal one lags.
struct QuickArm {
  ProxiedArm proxy{LiberoProfile(), *MethodOf(LiberoProfile())};
  Eigen::Vector3d x = Eigen::Vector3d(0.4, 0, 0.3);  // [m]
  int corrected = 0, doubts = 0;

  void Run(int answers, ProxyMode mode) {
    for (int i = 0; i < answers; ++i) {
      proxy.Observed(LiberoObservation({x[0], x[1], x[2], 0, 0, 0, 0.04, -0.04}), false, 0, mode);
      Eigen::MatrixXd asked = Eigen::MatrixXd::Zero(10, 7);
      for (int k = 0; k < 10; ++k)
        asked.row(k).head<3>() = Eigen::RowVector3d::Constant(0.1 * (0.4 + k));
      const std::string answer = ActionRows(asked);
      const std::string played = proxy.Answered(answer, false, 0, mode).value_or(answer);
      const Eigen::MatrixXd actions = ReadActions(played, *FindActions(played));
      for (int k = 0; k < 5; ++k) x += 0.7 * 0.05 * actions.row(k).head<3>().transpose();
      corrected += proxy.report().outcome == AnswerOutcome::kCorrected;
      doubts += proxy.report().doubt == Doubt::kHunting;
    }
  }
};

TEST(ProxiedArm, EndsACorrectionThatChasesItsOwnEffect) {
  QuickArm arm;
  arm.Run(60, ProxyMode::kOn);
  EXPECT_GT(arm.doubts, 40);
  EXPECT_LE(arm.corrected, 12);
  EXPECT_THAT(arm.proxy.report().words, HasSubstr("the correction of"));
  EXPECT_THAT(arm.proxy.report().words, HasSubstr("`nominal`"));
  const int before = arm.corrected;
  arm.Run(10, ProxyMode::kOn);
  EXPECT_EQ(arm.corrected, before) << "so it stays";
  arm.Run(1, ProxyMode::kOff);
  arm.Run(6, ProxyMode::kOn);
  EXPECT_GT(arm.corrected, before) << "switched on again";
}

// [m] that a healthy arm goes on, and is not asked to, once it is let go. Something held it for
// five seconds while the policy asked for half a command in x.
double WayAfterBeingHeld(const std::vector<std::string>& overrides) {
  ProxiedArm proxy{LiberoProfile(), *MethodOf(LiberoProfile(), overrides)};
  RubbingArm arm(0);
  const auto play = [&](int answers, double asked, bool held) {
    for (int i = 0; i < answers; ++i) {
      proxy.Observed(LiberoObservation(arm.state()), false, 0, ProxyMode::kOn);
      Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(10, 7);
      rows.col(0).setConstant(asked);
      const std::string answer = ActionRows(rows);
      const std::string played = proxy.Answered(answer, false, 0, ProxyMode::kOn).value_or(answer);
      const Eigen::MatrixXd actions = ReadActions(played, *FindActions(played));
      for (int k = 0; k < 5 && !held; ++k) arm.Step(actions.row(k).head<3>());
    }
  };
  play(10, 0.5, false);
  arm.Place(arm.x());
  play(20, 0.5, true);
  const double held_at = arm.x()[0];
  play(60, 0, false);
  return 0.05 * std::abs(arm.x()[0] - held_at);
}

TEST(ProxiedArm, AHeldArmDoesNotLungeWhenItIsLetGo) {
  const double open = WayAfterBeingHeld({"envelope_share=0"}), within = WayAfterBeingHeld({});
  std::printf("let go after 5 s: %.3f m, within the envelope %.3f m\n", open, within);
  EXPECT_GT(open, 0.1) << "what the envelope is for";
  EXPECT_LT(within, 0.02);
}

TEST(ProxiedArm, InShadowNothingHunts) {
  QuickArm arm;
  arm.Run(60, ProxyMode::kShadow);
  EXPECT_EQ(arm.doubts, 0);
}

}  // namespace
}  // namespace robostress
