// Whether intervals and tests keep what they promise where pairs share their initial state and not
// their sampling noise, and for laboratories that share nothing. States are easy, middling or hard,
// which is what makes them clusters. ROBOSTRESS_COVERAGE_RUNS=4000 gives the table of
// docs/results/unpaired-noise.md.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/random.h"
#include "common/statistics.h"
#include "eval/statistics/paired_tests.h"
#include "eval/statistics/unpaired_rates.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

constexpr int kReplicates = 400;
constexpr double kLevels[] = {0.05, 0.6, 0.95};  // chance of success, one of four states middling
constexpr double kShares[] = {0.25, 0.25, 0.5};

int CoverageRuns() {
  const char* runs = std::getenv("ROBOSTRESS_COVERAGE_RUNS");
  return runs == nullptr ? 600 : std::atoi(runs);
}

struct Design {
  int states = 100, repeats = 1, scenarios = 1;
  bool effect = true;  // the method helps half of the states and hurts the others
};

// A state: chances of base and method in each scenario.
struct State {
  std::vector<double> base, method;
};

double Harder(double level, int scenario, int scenarios) {
  return level * (1 - 0.3 * scenario / scenarios);
}

State DrawState(const Design& design, RandomStream& random) {
  const double u = random.Uniform();
  const double level = kLevels[u < kShares[0] ? 0 : u < kShares[0] + kShares[1] ? 1 : 2];
  const bool helped = random.Uniform() < 0.5;
  State state;
  for (int s = 0; s < design.scenarios; ++s) {
    const double p = Harder(level, s, design.scenarios);
    state.base.push_back(p);
    state.method.push_back(!design.effect ? p : helped ? p + 0.5 * (1 - p) : 0.8 * p);
  }
  return state;
}

// Over all states that there are: mean over scenarios of base, and of the method.
std::pair<double, double> Truth(const Design& design) {
  double base = 0, method = 0;
  for (int s = 0; s < design.scenarios; ++s) {
    for (int level = 0; level < 3; ++level) {
      const double p = Harder(kLevels[level], s, design.scenarios);
      const double q = design.effect ? 0.5 * (p + 0.5 * (1 - p)) + 0.5 * 0.8 * p : p;
      base += kShares[level] * p / design.scenarios;
      method += kShares[level] * q / design.scenarios;
    }
  }
  return {base, method};
}

struct Sample {
  std::vector<ClusteredValue> base, method, differences;
};

// Every episode with sampling noise of its own.
Sample Play(const Design& design, const std::vector<State>& states, RandomStream& random) {
  Sample sample;
  for (size_t i = 0; i < states.size(); ++i) {
    for (int s = 0; s < design.scenarios; ++s) {
      for (int r = 0; r < design.repeats; ++r) {
        const double a = random.Uniform() < states[i].base[s];
        const double b = random.Uniform() < states[i].method[s];
        sample.base.push_back({static_cast<int>(i), s, a});
        sample.method.push_back({static_cast<int>(i), s, b});
        sample.differences.push_back({static_cast<int>(i), s, b - a});
      }
    }
  }
  return sample;
}

std::vector<State> DrawStates(const Design& design, RandomStream& random) {
  std::vector<State> states;
  for (int i = 0; i < design.states; ++i) states.push_back(DrawState(design, random));
  return states;
}

bool Holds(const Interval& interval, double value) {
  return interval.low <= value && value <= interval.high;
}

// Clusters thrown away: each pair as one of its own.
std::vector<ClusteredValue> Loose(std::vector<ClusteredValue> values) {
  for (size_t i = 0; i < values.size(); ++i) values[i].cluster = static_cast<int>(i);
  return values;
}

// Shares of the runs in which an interval held the truth, or a test refused.
struct PairedOutcome {
  double clustered = 0, loose = 0, flips = 0;
};

PairedOutcome RunPaired(const Design& design) {
  const auto [base, method] = Truth(design);
  const int runs = CoverageRuns();
  PairedOutcome outcome;
  for (int run = 0; run < runs; ++run) {
    const StreamKey key = StreamKey("coverage").With(design.states).With(design.repeats).With(run);
    RandomStream random(key);
    const Sample sample = Play(design, DrawStates(design, random), random);
    outcome.clustered += Holds(
        ClusterBootstrap(sample.differences, kReplicates, key.With("a")).interval, method - base);
    outcome.loose +=
        Holds(ClusterBootstrap(Loose(sample.differences), kReplicates, key.With("b")).interval,
              method - base);
    if (!design.effect)
      outcome.flips += ClusterSignFlipTest(sample.differences, key.With("c")).p_value <= 0.05;
  }
  std::printf(
      "paired: states %3d, repeats %d, scenarios %d, effect %d: clusters %.3f, pairs as "
      "independent %.3f, flips refuse %.3f\n",
      design.states, design.repeats, design.scenarios, design.effect, outcome.clustered / runs,
      outcome.loose / runs, outcome.flips / runs);
  return {outcome.clustered / runs, outcome.loose / runs, outcome.flips / runs};
}

TEST(UnpairedNoise, PairedIntervalsHoldTheTruthWithRepeatsOfAState) {
  for (const Design& design :
       {Design{100, 1, 1}, Design{100, 5, 1}, Design{200, 3, 1}, Design{60, 3, 7}}) {
    const PairedOutcome outcome = RunPaired(design);
    EXPECT_GT(outcome.clustered, 0.92) << design.states << " " << design.repeats;
    EXPECT_LT(outcome.clustered, 0.98) << design.states << " " << design.repeats;
    if (design.repeats == 1) continue;
    EXPECT_LT(outcome.loose, outcome.clustered) << "repeats add no states";
  }
  if (CoverageRuns() > 600) RunPaired({20, 5, 1}), RunPaired({40, 5, 1}), RunPaired({20, 1, 1});
}

TEST(UnpairedNoise, SignFlipsRefuseOneTrueHypothesisInTwenty) {
  // Without an effect base and method are exchangeable within a state, whatever noise they share.
  for (const Design& design : {Design{20, 1, 1, false}, Design{20, 5, 1, false},
                               Design{100, 3, 1, false}, Design{30, 2, 7, false}}) {
    EXPECT_LT(RunPaired(design).flips, 0.075) << design.states << " " << design.repeats;
  }
}

struct RateOutcome {
  double clustered = 0, wilson = 0, difference = 0, refused = 0;
};

// Two laboratories play the same policy (effect false) or two of different worth.
RateOutcome RunLabs(const Design& first, const Design& second, bool same_states) {
  const double a = Truth(first).first,
               b = second.effect ? Truth(second).second : Truth(second).first;
  const int runs = CoverageRuns();
  RateOutcome outcome;
  for (int run = 0; run < runs; ++run) {
    RandomStream random(
        StreamKey("labs").With(first.states).With(second.repeats).With(second.effect).With(run));
    std::vector<State> states = DrawStates(first, random);
    const ClusteredRate one = RateOf(Play(first, states, random).base);
    if (!same_states) states = DrawStates(second, random);
    const Sample sample = Play(second, states, random);
    const ClusteredRate two = RateOf(second.effect ? sample.method : sample.base);
    const RateDifference difference = CompareRates(one, two);
    outcome.clustered += Holds(RateInterval(two), b);
    outcome.wilson += Holds(WilsonInterval(two.successes, two.n), b);
    outcome.difference += Holds(difference.interval, b - a);
    outcome.refused += difference.p_value <= 0.05;
  }
  std::printf(
      "labs: states %d and %d, repeats %d and %d, effect %d, same states %d: rate %.3f, "
      "Wilson %.3f, difference %.3f, test refuses %.3f\n",
      first.states, second.states, first.repeats, second.repeats, second.effect, same_states,
      outcome.clustered / runs, outcome.wilson / runs, outcome.difference / runs,
      outcome.refused / runs);
  return {outcome.clustered / runs, outcome.wilson / runs, outcome.difference / runs,
          outcome.refused / runs};
}

TEST(UnpairedNoise, RatesOfRepeatedStatesHoldTheTruthWhereWilsonDoesNot) {
  const RateOutcome once = RunLabs({100, 1, 1, false}, {100, 1, 1, false}, false);
  EXPECT_GT(once.clustered, 0.925);
  EXPECT_EQ(once.clustered, once.wilson) << "without repeats they are one";
  const RateOutcome repeated = RunLabs({100, 5, 1, false}, {100, 5, 1, false}, false);
  EXPECT_GT(repeated.clustered, 0.925);
  EXPECT_LT(repeated.wilson, 0.80) << "five episodes of a state are not five states";
}

TEST(UnpairedNoise, LaboratoriesAreComparedAtTheirLevel) {
  for (const auto& [first, second] :
       {std::pair(Design{100, 1, 1, false}, Design{50, 5, 1, false}),
        std::pair(Design{200, 3, 1, false}, Design{40, 1, 1, false})}) {
    const RateOutcome outcome = RunLabs(first, second, false);
    EXPECT_GT(outcome.difference, 0.925);
    EXPECT_LT(outcome.refused, 0.075);
  }
  const RateOutcome effect = RunLabs({100, 3, 1, false}, {100, 3, 1, true}, false);
  EXPECT_GT(effect.difference, 0.925);
  EXPECT_GT(effect.refused, RunLabs({100, 3, 1, false}, {100, 3, 1, false}, false).refused);
}

TEST(UnpairedNoise, EqualStatesMakeTheComparisonOfLaboratoriesCautious) {
  const RateOutcome shared = RunLabs({100, 3, 1, false}, {100, 3, 1, false}, true);
  EXPECT_GT(shared.difference, 0.97);
  EXPECT_LT(shared.refused, 0.03);
}

TEST(RateOf, DividesByKishsDesignEffect) {
  // Four states of two episodes: 2, 2, 1, 0 successes, p = 5/8. Sum of squares of the clusters'
  // deviations 2 x 0.75^2 + 0.25^2 + 1.25^2 = 2.75; of single outcomes 8 p (1 - p) = 1.875.
  std::vector<ClusteredValue> outcomes;
  for (const auto& [state, value] : std::vector<std::pair<int, double>>{
           {0, 1}, {0, 1}, {1, 1}, {1, 1}, {2, 1}, {2, 0}, {3, 0}, {3, 0}})
    outcomes.push_back({state, 0, value});
  const ClusteredRate rate = RateOf(outcomes);
  EXPECT_EQ(rate.n, 8);
  EXPECT_EQ(rate.successes, 5);
  EXPECT_EQ(rate.clusters, 4);
  EXPECT_NEAR(rate.design_effect, 2.75 / 1.875 * 4 / 3, 1e-12);
}

TEST(RateOf, StaysBetweenIndependentEpisodesAndOneForEachState) {
  std::vector<ClusteredValue> alike, opposed, all, single;
  for (int state = 0; state < 6; ++state) {
    for (int repeat = 0; repeat < 3; ++repeat) {
      alike.push_back({state, 0, state < 3 ? 1.0 : 0.0});
      opposed.push_back({state, 0, repeat == 1 ? 1.0 : 0.0});
      all.push_back({state, 0, 1.0});
    }
    single.push_back({state, 0, state < 3 ? 1.0 : 0.0});
  }
  EXPECT_EQ(RateOf(alike).design_effect, 3) << "repeats add nothing";
  EXPECT_EQ(RateOf(opposed).design_effect, 1);
  EXPECT_EQ(RateOf(all).design_effect, 3) << "not measurable: the cautious one";
  EXPECT_EQ(RateOf(single).design_effect, 1);
  // As many states as episodes: Wilson's own.
  const Interval wilson = WilsonInterval(3, 6), of_single = RateInterval(RateOf(single));
  EXPECT_EQ(of_single.low, wilson.low);
  EXPECT_EQ(of_single.high, wilson.high);
  // Repeats that add nothing: the interval of the states alone.
  const Interval of_alike = RateInterval(RateOf(alike));
  EXPECT_NEAR(of_alike.low, wilson.low, 1e-12);
  EXPECT_NEAR(of_alike.high, wilson.high, 1e-12);
  EXPECT_EQ(RateInterval(RateOf(all)).high, 1);
  EXPECT_NEAR(RateInterval(RateOf(all)).low, WilsonInterval(6, 6).low, 1e-12);
  EXPECT_TRUE(std::isnan(RateInterval({}).low));
}

TEST(CompareRates, IsNewcombesMethodTenAndTheScoreTest) {
  // Newcombe 1998, table II, (a): 56/70 - 48/80 has 0.0524 to 0.3339.
  const ClusteredRate first{80, 48, 80, 1}, second{70, 56, 70, 1};
  const RateDifference d = CompareRates(first, second);
  EXPECT_NEAR(d.estimate, 0.2, 1e-12);
  EXPECT_NEAR(d.interval.low, 0.0524, 5e-5);
  EXPECT_NEAR(d.interval.high, 0.3339, 5e-5);
  // Pooled: z = 0.2 / sqrt(104/150 x 46/150 x (1/70 + 1/80)) = 2.6503, p = 0.00804.
  const double z = 0.2 / std::sqrt(104. / 150 * 46 / 150 * (1. / 70 + 1. / 80));
  EXPECT_NEAR(d.p_value, std::erfc(z / std::sqrt(2)), 1e-12);
  // A design effect of 4 is a quarter of the episodes.
  const ClusteredRate fewer{20, 12, 20, 1}, clustered{80, 48, 20, 4};
  EXPECT_NEAR(CompareRates(fewer, second).interval.low,
              CompareRates(clustered, second).interval.low, 1e-12);
  EXPECT_NEAR(CompareRates(fewer, second).p_value, CompareRates(clustered, second).p_value, 1e-12);
  // The other way round it is the other sign.
  EXPECT_NEAR(CompareRates(second, first).interval.low, -d.interval.high, 1e-12);
  EXPECT_EQ(CompareRates({5, 5, 5, 1}, {7, 7, 7, 1}).p_value, 1);
  EXPECT_TRUE(std::isnan(CompareRates({}, second).p_value));
}

}  // namespace
}  // namespace robostress
