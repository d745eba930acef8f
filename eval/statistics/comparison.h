#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/statistics.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/store/run_store.h"

namespace robostress {

// Units of one cell of a table. They point into a RunData that outlives them.
using Units = std::vector<const UnitResult*>;
// The run's units, each episode once: of a scenario that is the same at every level, and was played
// at several of them, the units of the highest.
Units CountedUnits(const RunData& run);
// kTask where the method of any unit carries something from one episode to the next.
Clustering ClusteringOf(const std::vector<Units>& units);

// A method against a reference on the same episodes: equal suite, seed, task, episode and initial
// state.
struct Comparison {
  BootstrapResult difference;  // of success rates, method - reference; paired cluster bootstrap
  Clustering clustering = Clustering::kInitialState;  // of the interval and of the test
  int pairs = 0;
  int plus = 0, minus = 0;  // pairs only the method won, pairs only the reference won
  double p_value = 1;       // ClusterSignFlipTest
  bool p_exact = true;
  double mcnemar_p = 1;  // ExactMcNemar, which ignores clusters
  // p_value after Holm's correction over the table's comparisons; NaN until it is made.
  double p_holm = 0;
  double design_effect = 1;

  double discordant_share() const {
    return pairs == 0 ? 0 : static_cast<double>(plus + minus) / pairs;
  }
};

// "40 tasks", "200 initial states".
std::string ClustersText(const Comparison& comparison);

// What is compared within one stratum (scenario).
struct PairedUnits {
  Units method, reference;
};
Clustering ClusteringOf(const std::vector<PairedUnits>& strata);

// Pairs the episodes of each stratum; nullopt without a pair. Bootstrap and test are keyed by
// `label`.
std::optional<Comparison> CompareOnPairs(const std::vector<PairedUnits>& strata, int replicates,
                                         const std::string& label);

// Success over seeds: the paper reports the mean over three, which vary the sampling noise alone.
struct SeedSpread {
  std::vector<int64_t> seeds;
  std::vector<double> means;  // of each seed: mean over strata of success
  double mean = 0;            // over seeds
  double deviation = 0;       // standard deviation between seeds, n - 1; NaN with one seed
};
SeedSpread SpreadOverSeeds(const std::vector<Units>& strata);

// A measure of the same episodes before and after adaptation: the reference's, and the method's in
// episodes that began after its first update. Means over rollouts.
struct BeforeAfter {
  int pairs = 0;
  double before = 0, after = 0;
  BootstrapResult change;  // after - before
};
enum class AdaptationMeasure { kResidual, kIntent };
std::optional<BeforeAfter> CompareBeforeAfter(const std::vector<PairedUnits>& strata,
                                              AdaptationMeasure measure, int replicates,
                                              const std::string& label);

}  // namespace robostress
