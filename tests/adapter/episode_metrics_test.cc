#include "adapter/episode_metrics.h"

#include <gtest/gtest.h>

#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

Eigen::VectorXf Command() {
  return (Eigen::VectorXf(7) << 0.5f, -0.25f, 0.8f, 0.1f, -0.2f, 0.3f, 1.0f).finished();
}

TEST(EpisodeMetrics, OfAnArmWithGainGIsOneMinusG) {
  EpisodeMetrics metrics({});
  ToyArm arm(0.25);
  for (int i = 0; i < 3; ++i) metrics.Add(arm.Execute(ConstantPrediction(Command(), 5), 5));
  EXPECT_EQ(metrics.steps(), 15);
  EXPECT_NEAR(metrics.residual(), 0.75, 1e-9);
  EXPECT_NEAR(metrics.residual_tracking(), 1 - 0.25 / 0.267, 1e-9);
  EXPECT_NEAR(*metrics.intent(), 0.75, 1e-9);
}

TEST(EpisodeMetrics, IsTheRatioOfStackedNormsNotTheMeanOfRatios) {
  EpisodeMetrics metrics({});
  Eigen::VectorXf large = Command();
  Eigen::VectorXf tiny = Command() * 1e-3f;
  metrics.Add(ToyArm(1.0).Execute(ConstantPrediction(large, 1), 1));  // residual 0
  metrics.Add(
      ToyArm(0.0).Execute(ConstantPrediction(tiny, 1), 1));  // residual 100 % of very little
  EXPECT_LT(metrics.residual(), 0.01);
}

TEST(EpisodeMetrics, MeasuresIntentAgainstTheUnadaptedPolicy) {
  PredictedChunk prediction = ConstantPrediction(Command(), 5);
  prediction.base_actions.leftCols(6) *= 0.5f;
  EpisodeMetrics metrics({});
  metrics.Add(ToyArm(0.5).Execute(prediction, 5));
  EXPECT_NEAR(*metrics.intent(), 0, 1e-6);
  EXPECT_NEAR(metrics.residual(), 0.5, 1e-6);
}

TEST(EpisodeMetrics, LeavesOutWhatIsMasked) {
  const ExecutedChunk chunk = ToyArm(0.25).Execute(ConstantPrediction(Command(), 5), 5);
  EpisodeMetrics all({}), some({});
  all.Add(chunk);
  ExecutedChunk held = chunk;
  held.masked = {false, false, false, true, true};
  for (const size_t i : {3u, 4u}) held.steps[i].policy_command.setZero();
  some.Add(held);
  EXPECT_EQ(some.steps(), 3);
  EXPECT_NEAR(some.residual(), all.residual(), 1e-9);
  EXPECT_NEAR(some.mean_abs_action(), all.mean_abs_action(), 1e-9);
}

TEST(EpisodeMetrics, SaysWhenTheUnadaptedPolicyIsUnknown) {
  PredictedChunk prediction = ConstantPrediction(Command(), 5);
  prediction.base_actions.resize(0, 0);
  EpisodeMetrics metrics({});
  metrics.Add(ToyArm(1).Execute(prediction, 5));
  EXPECT_FALSE(metrics.intent().has_value());
}

TEST(EpisodeMetrics, DoesNotDependOnTheMethodsResidualScale) {
  ResidualOptions tracking;
  tracking.scale = ResidualScale::kTracking;
  EpisodeMetrics a({}), b(tracking);
  const ExecutedChunk chunk = ToyArm(0.4).Execute(ConstantPrediction(Command(), 5), 5);
  a.Add(chunk);
  b.Add(chunk);
  EXPECT_EQ(a.residual(), b.residual());
  EXPECT_EQ(a.residual_tracking(), b.residual_tracking());
}

TEST(EpisodeMetrics, CountsClippedEntriesOfWhatWasSentWithoutTheGripper) {
  PredictedChunk prediction = ConstantPrediction(Command(), 2);
  prediction.actions(0, 0) = 1.5f;
  prediction.actions(1, 3) = -1.0f;  // at the limit, not beyond it
  prediction.actions(1, 6) = 9.0f;
  EpisodeMetrics metrics({});
  metrics.Add(ToyArm(1).Execute(prediction, 2));
  EXPECT_DOUBLE_EQ(metrics.clipped_share(), 1.0 / 12);
  EXPECT_NEAR(metrics.mean_abs_action(), (0.5 + 0.25 + 0.8 + 0.1 + 0.2 + 0.3) / 6, 1e-7);
}

TEST(EpisodeMetrics, OfNothingIsZero) {
  const EpisodeMetrics metrics({});
  EXPECT_EQ(metrics.residual(), 0);
  EXPECT_EQ(metrics.clipped_share(), 0);
}

}  // namespace
}  // namespace robostress
