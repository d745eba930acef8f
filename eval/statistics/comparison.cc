#include "eval/statistics/comparison.h"

#include <cmath>
#include <limits>
#include <map>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/joint_errors/scenario_file.h"
#include "eval/plan/plan.h"
#include "eval/statistics/paired_tests.h"

namespace robostress {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

using EpisodeKey = std::tuple<std::string, int64_t, int, int>;  // suite, seed, task, episode

std::map<EpisodeKey, const EpisodeRow*> RowsOf(const Units& units) {
  std::map<EpisodeKey, const EpisodeRow*> rows;
  for (const UnitResult* unit : units) {
    for (const EpisodeRow& row : unit->episodes)
      rows[{unit->config.suite, unit->config.seed, row.task, row.episode}] = &row;
  }
  return rows;
}

// Calls use(unit, method's row, reference's row, stratum) for every pair.
template <class Use>
void ForEachPair(const std::vector<PairedUnits>& strata, const Use& use) {
  for (size_t stratum = 0; stratum < strata.size(); ++stratum) {
    const std::map<EpisodeKey, const EpisodeRow*> reference = RowsOf(strata[stratum].reference);
    for (const UnitResult* unit : strata[stratum].method) {
      for (const EpisodeRow& row : unit->episodes) {
        const auto pair =
            reference.find({unit->config.suite, unit->config.seed, row.task, row.episode});
        if (pair != reference.end() && pair->second->initial_state == row.initial_state)
          use(*unit, row, *pair->second, static_cast<int>(stratum));
      }
    }
  }
}

}  // namespace

Units CountedUnits(const RunData& run) {
  std::map<std::string, bool> same_at_every_level;  // by scenario, which may be a file
  using Copies = std::tuple<std::string, std::string, std::string, std::string, int64_t>;
  std::map<Copies, size_t> places;
  Units units;
  for (const UnitResult& unit : run.units) {
    const UnitConfig& c = unit.config;
    auto same = same_at_every_level.find(c.scenario);
    if (same == same_at_every_level.end())
      same = same_at_every_level.emplace(c.scenario, SameAtEveryLevel(c.scenario)).first;
    if (same->second) {
      const auto [place, first] =
          places.emplace(Copies{c.suite, ScenarioLabel(c.scenario), PolicyLabel(c.policy),
                                c.method->method, c.seed},
                         units.size());
      if (!first) {
        const UnitResult*& counted = units[place->second];
        if (counted->config.severity < c.severity) counted = &unit;
        continue;
      }
    }
    units.push_back(&unit);
  }
  return units;
}

Clustering ClusteringOf(const std::vector<Units>& units) {
  for (const Units& some : units) {
    for (const UnitResult* unit : some) {
      if (unit->config.method->CarriesOver()) return Clustering::kTask;
    }
  }
  return Clustering::kInitialState;
}

Clustering ClusteringOf(const std::vector<PairedUnits>& strata) {
  std::vector<Units> units;
  for (const PairedUnits& pair : strata) units.insert(units.end(), {pair.method, pair.reference});
  return ClusteringOf(units);
}

std::string ClustersText(const Comparison& comparison) {
  return absl::StrCat(comparison.difference.clusters, " ", ClusterNoun(comparison.clustering));
}

std::optional<Comparison> CompareOnPairs(const std::vector<PairedUnits>& strata, int replicates,
                                         const std::string& label) {
  Comparison comparison;
  std::vector<EpisodeValue> differences;
  ForEachPair(strata, [&](const UnitResult& unit, const EpisodeRow& row,
                          const EpisodeRow& reference, int stratum) {
    ++comparison.pairs;
    comparison.plus += row.success && !reference.success;
    comparison.minus += !row.success && reference.success;
    differences.push_back({unit.config.suite, row.task, row.initial_state, stratum,
                           static_cast<double>(row.success) - reference.success});
  });
  if (comparison.pairs == 0) return std::nullopt;
  comparison.clustering = ClusteringOf(strata);
  comparison.difference = BootstrapEpisodes(differences, replicates, label, comparison.clustering);
  const std::vector<ClusteredValue> clustered = ClusterEpisodes(differences, comparison.clustering);
  const SignFlipResult test =
      ClusterSignFlipTest(clustered, StreamKey("eval/sign flips").With(label));
  comparison.p_value = test.p_value;
  comparison.p_exact = test.exact;
  comparison.mcnemar_p = ExactMcNemar(comparison.plus, comparison.minus);
  comparison.p_holm = kNaN;
  comparison.design_effect = DesignEffect(clustered);
  return comparison;
}

SeedSpread SpreadOverSeeds(const std::vector<Units>& strata) {
  std::map<int64_t, std::map<size_t, std::pair<int, int>>> counts;  // seed -> stratum -> won, n
  for (size_t stratum = 0; stratum < strata.size(); ++stratum) {
    for (const UnitResult* unit : strata[stratum]) {
      auto& [won, n] = counts[unit->config.seed][stratum];
      for (const EpisodeRow& row : unit->episodes) {
        won += row.success;
        ++n;
      }
    }
  }
  SeedSpread spread;
  for (const auto& [seed, by_stratum] : counts) {
    double sum = 0;
    int present = 0;
    for (const auto& [stratum, count] : by_stratum) {
      if (count.second == 0) continue;
      sum += static_cast<double>(count.first) / count.second;
      ++present;
    }
    if (present == 0) continue;
    spread.seeds.push_back(seed);
    spread.means.push_back(sum / present);
  }
  const double n = static_cast<double>(spread.means.size());
  for (const double mean : spread.means) spread.mean += mean / n;
  double squares = 0;
  for (const double mean : spread.means) squares += (mean - spread.mean) * (mean - spread.mean);
  if (spread.means.empty()) spread.mean = kNaN;
  spread.deviation = n < 2 ? kNaN : std::sqrt(squares / (n - 1));
  return spread;
}

std::optional<BeforeAfter> CompareBeforeAfter(const std::vector<PairedUnits>& strata,
                                              AdaptationMeasure measure, int replicates,
                                              const std::string& label) {
  const auto field =
      measure == AdaptationMeasure::kResidual ? &EpisodeRow::residual : &EpisodeRow::intent;
  BeforeAfter result;
  std::vector<EpisodeValue> changes;
  ForEachPair(strata, [&](const UnitResult& unit, const EpisodeRow& row,
                          const EpisodeRow& reference, int stratum) {
    // `updates` counts up to an episode's end, so the episode before tells how this one began.
    const bool began_adapted = &row != &unit.episodes.front() && (&row - 1)->updates > 0;
    if (!(row.*field) || !(reference.*field) || !began_adapted) return;
    ++result.pairs;
    result.before += *(reference.*field);
    result.after += *(row.*field);
    changes.push_back({unit.config.suite, row.task, row.initial_state, stratum,
                       *(row.*field) - *(reference.*field)});
  });
  if (result.pairs == 0) return std::nullopt;
  result.before /= result.pairs;
  result.after /= result.pairs;
  result.change = BootstrapEpisodes(changes, replicates, label, ClusteringOf(strata));
  return result;
}

}  // namespace robostress
