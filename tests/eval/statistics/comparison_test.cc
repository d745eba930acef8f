#include "eval/statistics/comparison.h"

#include <cmath>
#include <vector>

#include "adapter/method_options.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/measures.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

// A unit with a seed of its own.
UnitResult Seeded(int64_t seed, const std::string& method, const std::vector<int>& outcomes) {
  UnitResult unit = SyntheticUnit("heavy_payload", method, outcomes);
  unit.config.seed = seed;
  return unit;
}

Comparison Compare(const std::vector<UnitResult>& units) {
  PairedUnits pairs;
  for (const UnitResult& unit : units)
    (unit.config.method->method == "base" ? pairs.reference : pairs.method).push_back(&unit);
  const auto comparison = CompareOnPairs({pairs}, 500, "test");
  EXPECT_TRUE(comparison.has_value());
  return *comparison;
}

const std::vector<int> kLost = {0, 0, 0, 0, 0, 0, 1, 0, 1}, kWon = {1, 1, 1, 1, 1, 1, 0, 0, 1};

TEST(Comparison, SeedsOfOneInitialStateAreOneClusterHoweverManyThereAre) {
  // 6 to 1 of seven states that differ: 2 (1 + 7) / 2^7. Two more seeds that end alike add pairs,
  // no evidence.
  const Comparison one = Compare({Seeded(0, "base", kLost), Seeded(0, "gain", kWon)});
  std::vector<UnitResult> units;
  for (const int64_t seed : {0, 1, 2}) {
    units.push_back(Seeded(seed, "base", kLost));
    units.push_back(Seeded(seed, "gain", kWon));
  }
  const Comparison three = Compare(units);
  EXPECT_EQ(one.pairs, 9);
  EXPECT_EQ(three.pairs, 27);
  EXPECT_NEAR(one.p_value, 16.0 / 128, 1e-12);
  EXPECT_NEAR(three.p_value, one.p_value, 1e-12);
  EXPECT_EQ(three.difference.clusters, 9);
  EXPECT_EQ(three.difference.interval.low, one.difference.interval.low);
  EXPECT_EQ(three.difference.interval.high, one.difference.interval.high);
  EXPECT_NEAR(three.design_effect, 3 * one.design_effect, 1e-9);
  EXPECT_LT(three.mcnemar_p, 0.01) << "what ignoring the clusters would say";
}

TEST(Comparison, ASessionThatIsCarriedMakesATaskOneCluster) {
  // Two tasks of three states. What every episode of a task shares is no six independent wins.
  const auto task = [](const std::string& method, int index, const std::vector<int>& outcomes) {
    UnitResult unit = Seeded(index, method, outcomes);
    for (EpisodeRow& row : unit.episodes) row.task = index;
    return unit;
  };
  const auto both = [&](const std::string& method) {
    return Compare({task("base", 0, {0, 0, 0}), task("base", 1, {0, 0, 0}),
                    task(method, 0, {1, 1, 1}), task(method, 1, {1, 1, 1})});
  };
  const Comparison gain = both("gain"), following = both("ours_following");
  EXPECT_EQ(ClustersText(gain), "6 initial states");
  EXPECT_EQ(ClustersText(following), "2 tasks");
  EXPECT_NEAR(gain.p_value, 2.0 / 64, 1e-12);
  EXPECT_NEAR(following.p_value, 2.0 / 4, 1e-12);
  EXPECT_EQ(following.difference.estimate, gain.difference.estimate);
  EXPECT_NEAR(following.mcnemar_p, gain.mcnemar_p, 1e-12);
}

TEST(Comparison, PairsASeedWithItselfOnly) {
  const Comparison comparison = Compare({Seeded(0, "base", {1, 1}), Seeded(1, "base", {0, 0}),
                                         Seeded(0, "ours", {1, 1}), Seeded(1, "ours", {0, 0})});
  EXPECT_EQ(comparison.pairs, 4);
  EXPECT_EQ(comparison.plus + comparison.minus, 0);
  EXPECT_EQ(comparison.difference.estimate, 0);
}

TEST(Comparison, LeavesOutAPairThatStartedElsewhere) {
  std::vector<UnitResult> units = {Seeded(0, "base", {0, 0, 0}), Seeded(0, "ours", {1, 1, 1})};
  units[1].episodes[2].initial_state = 17;
  const Comparison comparison = Compare(units);
  EXPECT_EQ(comparison.pairs, 2);
  EXPECT_EQ(comparison.plus, 2);
}

TEST(SeedSpread, IsTheMeanOverScenariosOfEachSeedAndItsSampleDeviation) {
  // Seed 0: (1/2 + 1) / 2, seed 1: (0 + 1/2) / 2; scenarios weigh alike whatever their size.
  const UnitResult a0 = Seeded(0, "base", {1, 0}), a1 = Seeded(1, "base", {0, 0});
  const UnitResult b0 = Seeded(0, "base", {1, 1, 1, 1}), b1 = Seeded(1, "base", {1, 0, 1, 0});
  const SeedSpread spread = SpreadOverSeeds({{&a0, &a1}, {&b0, &b1}});
  ASSERT_EQ(spread.means.size(), 2u);
  EXPECT_NEAR(spread.means[0], 0.75, 1e-12);
  EXPECT_NEAR(spread.means[1], 0.25, 1e-12);
  EXPECT_NEAR(spread.mean, 0.5, 1e-12);
  EXPECT_NEAR(spread.deviation, 0.5 / std::sqrt(2.0), 1e-12);
}

TEST(BeforeAfter, CountsEpisodesThatBeganAfterTheFirstUpdate) {
  // Updates are counted at an episode's end: the third is the first that began adapted.
  std::vector<UnitResult> units = {
      SyntheticUnit("heavy_payload", "base", {0, 0, 0, 0}),
      SyntheticUnit("heavy_payload", "ours", {0, 0, 0, 0}, {0, 2, 3, 5})};
  for (int i = 0; i < 4; ++i) {
    units[0].episodes[i].residual = 0.5;
    units[1].episodes[i].residual = 0.1 * (i + 1);
  }
  const auto change =
      CompareBeforeAfter({{{&units[1]}, {&units[0]}}}, AdaptationMeasure::kResidual, 100, "test");
  ASSERT_TRUE(change.has_value());
  EXPECT_EQ(change->pairs, 2);
  EXPECT_NEAR(change->before, 0.5, 1e-12);
  EXPECT_NEAR(change->after, 0.35, 1e-12);
  EXPECT_NEAR(change->change.estimate, -0.15, 1e-12);
}

TEST(BootstrapUnpaired, IsTheDifferenceOfTwoSamplesThatAreDrawnApart) {
  // Two samples of 200 states, half of them won in the first and a fifth in the second.
  std::vector<EpisodeValue> first, second;
  for (int i = 0; i < 200; ++i) {
    first.push_back({"tabletop_goal", 0, i, 0, i % 2 == 0 ? 1.0 : 0.0});
    second.push_back({"tabletop_goal", 0, i, 0, i % 5 == 0 ? 1.0 : 0.0});
  }
  const BootstrapResult difference = BootstrapUnpaired(first, second, 4000, "test");
  EXPECT_NEAR(difference.estimate, 0.3, 1e-12);
  const double half = 1.96 * std::sqrt((0.25 + 0.16) / 200);
  EXPECT_NEAR(difference.interval.low, 0.3 - half, 0.1 * half);
  EXPECT_NEAR(difference.interval.high, 0.3 + half, 0.1 * half);
  // A sample against itself: no difference, and still two samples.
  const BootstrapResult none = BootstrapUnpaired(first, first, 4000, "test");
  EXPECT_EQ(none.estimate, 0);
  EXPECT_NEAR(none.interval.high, 1.96 * std::sqrt(0.5 / 200), 0.01);
}

TEST(Measures, TellTheDistanceAtTheEndOfAUnit) {
  UnitResult unit = SyntheticUnit("heavy_payload", "ours", {0, 0, 0});
  for (int i = 0; i < 3; ++i) unit.episodes[i].adapter_distance = 0.1 * (i + 1);
  EXPECT_NEAR(*MeasuresOf({&unit}).adapter_distance, 0.3, 1e-12);
}

}  // namespace
}  // namespace robostress
