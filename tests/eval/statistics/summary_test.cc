#include "eval/statistics/summary.h"

#include <cmath>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/shared_run.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

TEST(Summary, CountsDiscordantPairsOnTheSameEpisodes) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {1, 1, 0, 0, 0}),
               SyntheticUnit("heavy_payload", "ours", {1, 0, 1, 1, 0}, {0, 0, 1, 2, 3})};
  const Summary summary = Summarise(run, 200);
  const Cell& ours = summary.tables.at(0).rows.at(0).cells.at("ours");
  ASSERT_TRUE(ours.contrasts.versus_base.has_value());
  EXPECT_EQ(ours.contrasts.versus_base->pairs, 5);
  EXPECT_EQ(ours.contrasts.versus_base->plus, 2);
  EXPECT_EQ(ours.contrasts.versus_base->minus, 1);
  EXPECT_NEAR(ours.contrasts.versus_base->difference.estimate, 0.2, 1e-12);
  EXPECT_EQ(ours.updates, 3);
  EXPECT_FALSE(summary.tables.at(0).rows.at(0).cells.at("base").contrasts.versus_base.has_value());
}

TEST(Summary, RepeatsOfAServerThatTakesNoSeedAreNoFurtherStates) {
  RunData run = RemoteRun();
  const Summary summary = Summarise(run, 100);
  EXPECT_FALSE(summary.noise_paired);
  EXPECT_FALSE(summary.tables.at(0).noise_paired);
  const Cell& cell = summary.tables.at(0).rows.at(1).cells.at("ours_following");
  EXPECT_EQ(cell.n, 8);
  EXPECT_EQ(cell.clustered.clusters, 4);
  // 2, 2, 2, 0 of four states: two repeats say what one does.
  EXPECT_EQ(cell.clustered.design_effect, 2);
  EXPECT_NEAR(cell.wilson.low, WilsonInterval(3, 4).low, 1e-12);
  EXPECT_NEAR(cell.wilson.high, WilsonInterval(3, 4).high, 1e-12);
  for (UnitResult& unit : run.units) unit.config.remote.dialect.seed = "seed";
  const Summary paired = Summarise(run, 100);
  EXPECT_TRUE(paired.tables.at(0).noise_paired);
  const Cell& seeds = paired.tables.at(0).rows.at(1).cells.at("ours_following");
  EXPECT_EQ(seeds.wilson.low, WilsonInterval(6, 8).low) << "seeds, as in every table so far";
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

// As a second sweep with other --severities leaves it: Clean is planned at the highest of each.
TEST(Summary, CleanThatWasPlayedAtTwoLevelsCountsOnce) {
  const auto at = [](int severity, UnitResult unit) {
    unit.config.severity = severity;
    unit.id = UnitId(unit.config);
    return unit;
  };
  RunData once, twice;
  for (const int severity : {5, 3}) {
    for (RunData* run : {&once, &twice}) {
      if (run == &once && severity == 3) continue;
      run->units.push_back(at(severity, SyntheticUnit("clean", "base", {0, 0, 1, 0, 0, 0})));
      run->units.push_back(at(severity, SyntheticUnit("clean", "gain", {1, 1, 1, 1, 1, 1})));
    }
  }
  for (RunData* run : {&once, &twice})
    run->units.push_back(at(3, SyntheticUnit("heavy_payload", "base", {1})));
  const Summary summary = Summarise(twice, 50), expected = Summarise(once, 50);
  ASSERT_EQ(summary.tables.size(), 1u);
  const Cell &gain = summary.tables[0].rows[0].cells.at("gain"),
             &alone = expected.tables[0].rows[0].cells.at("gain");
  EXPECT_EQ(gain.n, 6);
  EXPECT_EQ(gain.contrasts.versus_base->pairs, 6);
  EXPECT_EQ(gain.contrasts.versus_base->mcnemar_p, alone.contrasts.versus_base->mcnemar_p);
  EXPECT_EQ(summary.episodes, expected.episodes);
}

TEST(Summary, OneScenarioAndPolicyUnderTwoSpellingsAreOneRow) {
  RunData run;
  run.units = {SyntheticUnit("here/worn.yaml", "base", {0, 1}),
               SyntheticUnit("/there/worn.yaml", "gain", {1, 1})};
  run.units[0].config.policy = "mine.safetensors";
  run.units[1].config.policy = "/there/mine.safetensors";
  const Summary summary = Summarise(run, 50);
  ASSERT_EQ(summary.tables.size(), 1u);
  EXPECT_EQ(summary.tables[0].policy, "mine");
  ASSERT_EQ(summary.tables[0].rows.size(), 1u);
  EXPECT_EQ(summary.tables[0].rows[0].scenario, "worn");
  EXPECT_EQ(summary.tables[0].rows[0].cells.at("gain").contrasts.versus_base->pairs, 2);
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

TEST(Summary, PutsTheControlsBesideEveryCompensatingMethod) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {0, 0, 0, 1}),
               SyntheticUnit("heavy_payload", "ours", {1, 1, 0, 1}),
               SyntheticUnit("heavy_payload", "ours_integral", {1, 1, 1, 1}),
               SyntheticUnit("heavy_payload", "gain", {1, 0, 0, 0}),
               SyntheticUnit("heavy_payload", "null", {0, 1, 0, 1})};
  const Summary summary = Summarise(run, 100);
  const auto& cells = summary.tables.at(0).rows.at(0).cells;
  const Contrasts& ours = cells.at("ours").contrasts;
  EXPECT_NEAR(ours.versus_control.at("gain").difference.estimate, 0.5, 1e-12);
  EXPECT_NEAR(ours.versus_control.at("null").difference.estimate, 0.25, 1e-12);
  const Contrasts& integral = cells.at("ours_integral").contrasts;
  EXPECT_NEAR(integral.versus_control.at("gain").difference.estimate, 0.75, 1e-12);
  EXPECT_TRUE(cells.at("gain").contrasts.versus_control.empty()) << "a control has no control";
}

TEST(Summary, CorrectsTheComparisonsWithBaseForTheirNumber) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {0, 0, 0, 0, 0, 0, 0, 0}),
               SyntheticUnit("heavy_payload", "gain", {1, 1, 1, 1, 1, 1, 1, 1}),
               SyntheticUnit("aged_joint_elbow", "base", {0, 0, 0, 0, 0, 0, 0, 1}),
               SyntheticUnit("aged_joint_elbow", "gain", {1, 0, 0, 0, 0, 0, 0, 1})};
  const Summary summary = Summarise(run, 100);
  const SuccessTable& table = summary.tables.at(0);
  const Comparison& payload = *table.rows.at(0).cells.at("gain").contrasts.versus_base;
  EXPECT_NEAR(payload.p_value, 2 / 256.0, 1e-12);
  EXPECT_NEAR(payload.p_holm, 4 / 256.0, 1e-12);
  const Comparison& elbow = *table.rows.at(1).cells.at("gain").contrasts.versus_base;
  EXPECT_NEAR(elbow.p_value, 1, 1e-12);
  const Comparison& average = *table.averages.at("gain").contrasts.versus_base;
  EXPECT_EQ(average.p_holm, average.p_value) << "one average is a family of its own";
}

TEST(Summary, SpreadsOverSeedsWithTheSeedsMeans) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {1, 1, 1, 0}),
               SyntheticUnit("heavy_payload", "base", {1, 0, 0, 0})};
  run.units[1].config.seed = 1;
  const Summary summary = Summarise(run, 10);
  const SeedSpread& seeds = summary.tables.at(0).rows.at(0).cells.at("base").seeds;
  EXPECT_THAT(seeds.means, ::testing::ElementsAre(0.75, 0.25));
  EXPECT_NEAR(seeds.mean, 0.5, 1e-12);
  EXPECT_NEAR(seeds.deviation, 0.5 / std::sqrt(2), 1e-12);
}

TEST(Summary, BeforeAndAfterArePairedOnEpisodesThatBeganAdapted) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {1, 1, 1}),
               SyntheticUnit("heavy_payload", "ours", {1, 1, 1}, {1, 2, 3})};
  for (int i = 0; i < 3; ++i) {
    run.units[0].episodes[i].residual = 0.5 + 0.1 * i;
    run.units[1].episodes[i].residual = 0.4 + 0.1 * i;
  }
  const Summary summary = Summarise(run, 10);
  const Contrasts& ours = summary.tables.at(0).rows.at(0).cells.at("ours").contrasts;
  ASSERT_TRUE(ours.residual.has_value());
  EXPECT_EQ(ours.residual->pairs, 2) << "the first episode began without an update";
  EXPECT_NEAR(ours.residual->before, 0.65, 1e-12);
  EXPECT_NEAR(ours.residual->change.estimate, -0.1, 1e-12);
  EXPECT_FALSE(ours.intent.has_value());
}

}  // namespace
}  // namespace robostress
