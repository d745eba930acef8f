#include "eval/summary.h"

#include <cmath>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

TEST(Summary, CountsDiscordantPairsOnTheSameEpisodes) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {1, 1, 0, 0, 0}),
               SyntheticUnit("heavy_payload", "ours", {1, 0, 1, 1, 0}, {0, 0, 1, 2, 3})};
  const Summary summary = Summarise(run, 200);
  const Cell& ours = summary.tables.at(0).rows.at(0).cells.at("ours");
  ASSERT_TRUE(ours.versus_base.has_value());
  EXPECT_EQ(ours.versus_base->pairs, 5);
  EXPECT_EQ(ours.versus_base->plus, 2);
  EXPECT_EQ(ours.versus_base->minus, 1);
  EXPECT_NEAR(ours.versus_base->difference.estimate, 0.2, 1e-12);
  EXPECT_EQ(ours.updates, 3);
  EXPECT_FALSE(summary.tables.at(0).rows.at(0).cells.at("base").versus_base.has_value());
}

TEST(Summary, AverageLeavesCleanOutAndWeighsScenariosEqually) {
  RunData run;
  run.units = {SyntheticUnit("clean", "base", {1, 1, 1, 1}),
               SyntheticUnit("heavy_payload", "base", {1, 0, 0, 0}),
               SyntheticUnit("aged_joint_elbow", "base", {1, 1})};
  const AverageCell& average = Summarise(run, 200).tables.at(0).averages.at("base");
  EXPECT_NEAR(average.success.estimate, (0.25 + 1.0) / 2, 1e-12);
  EXPECT_EQ(average.success.clusters, 4);
}

TEST(Summary, AdaptingMethodWithoutAnUpdateIsNotAdapted) {
  RunData run;
  run.units = {SyntheticUnit("clean", "base", {1}), SyntheticUnit("clean", "ours", {1})};
  const auto& cells = Summarise(run, 10).tables.at(0).rows.at(0).cells;
  EXPECT_EQ(UpdatesText(cells.at("ours").adapts, cells.at("ours").updates), "not adapted");
  EXPECT_EQ(UpdatesText(cells.at("base").adapts, cells.at("base").updates), "-");
  EXPECT_EQ(UpdatesText(true, 7), "7");
}

TEST(Summary, ResidualsAreMeansOverRolloutsAndPooledSums) {
  RunData run;
  run.units = {SyntheticUnit("clean", "base", {1, 1, 0})};
  // Rollouts of different length: the mean of ratios and the ratio of sums differ. The third has no
  // measure.
  run.units[0].episodes[0].residual = 0.5, run.units[0].episodes[0].eta_sq = 1,
  run.units[0].episodes[0].a_sq = 4;
  run.units[0].episodes[1].residual = 0.1, run.units[0].episodes[1].eta_sq = 1,
  run.units[0].episodes[1].a_sq = 100;
  const Measures measures = Summarise(run, 10).tables.at(0).rows.at(0).cells.at("base").measures;
  EXPECT_NEAR(*measures.residual_mean, 0.3, 1e-12);
  EXPECT_NEAR(*measures.residual_pooled, std::sqrt(2.0 / 104), 1e-12);
  EXPECT_FALSE(measures.intent_mean.has_value());
}

TEST(Summary, SeveralSuitesGetATableEachAfterTheCommonOne) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {1, 0}, {}, "tabletop_spatial"),
               SyntheticUnit("heavy_payload", "base", {0, 0}, {}, "tabletop_goal")};
  const Summary summary = Summarise(run, 10);
  ASSERT_EQ(summary.tables.size(), 3u);
  EXPECT_EQ(summary.tables[0].suite, "");
  EXPECT_NEAR(summary.tables[0].averages.at("base").success.estimate, 0.25, 1e-12);
  EXPECT_EQ(summary.tables[1].suite, "tabletop_spatial");
  // The same task and state of two suites are two clusters.
  EXPECT_EQ(summary.tables[0].averages.at("base").success.clusters, 4);
}

TEST(Summary, CleanStandsInTheTableOfEverySeverity) {
  RunData run;
  run.units = {SyntheticUnit("clean", "base", {1}), SyntheticUnit("heavy_payload", "base", {1}),
               SyntheticUnit("heavy_payload", "base", {0})};
  run.units[1].config.severity = 1;
  const Summary summary = Summarise(run, 10);
  ASSERT_EQ(summary.tables.size(), 2u);
  for (const SuccessTable& table : summary.tables) {
    ASSERT_EQ(table.rows.size(), 2u);
    EXPECT_EQ(table.rows[0].scenario, "clean");
  }
  EXPECT_EQ(summary.tables[0].averages.at("base").success.estimate, 1);
  EXPECT_EQ(summary.tables[1].averages.at("base").success.estimate, 0);
}

TEST(Summary, CurvesFollowTheEpisodesOfAUnitWithoutClean) {
  RunData run;
  run.units = {SyntheticUnit("clean", "ours", {0, 0}),
               SyntheticUnit("heavy_payload", "ours", {1, 0}),
               SyntheticUnit("aged_joint_elbow", "ours", {1, 1})};
  const Summary summary = Summarise(run, 10);
  ASSERT_EQ(summary.curves.size(), 1u);
  EXPECT_THAT(summary.curves[0].curves.at(0).success, ::testing::ElementsAre(1.0, 0.5));
}

}  // namespace
}  // namespace robostress
