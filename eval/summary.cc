#include "eval/summary.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/joint_errors/scenario_file.h"
#include "common/suites.h"
#include "eval/episode_bootstrap.h"
#include "eval/plan.h"

namespace robostress {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

using Units = std::vector<const UnitResult*>;

// Running mean of a measure that some episodes lack.
class Mean {
 public:
  void Add(const std::optional<double>& value) {
    if (!value) return;
    sum_ += *value;
    ++count_;
  }
  std::optional<double> value() const {
    return count_ == 0 ? std::nullopt : std::optional<double>(sum_ / count_);
  }

 private:
  double sum_ = 0;
  int count_ = 0;
};

// sqrt(sum numerator / sum denominator) over the episodes that have both.
class PooledRatio {
 public:
  void Add(const std::optional<double>& numerator, const std::optional<double>& denominator) {
    if (!numerator || !denominator) return;
    numerator_ += *numerator;
    denominator_ += *denominator;
  }
  std::optional<double> value() const {
    return denominator_ > 0 ? std::optional<double>(std::sqrt(numerator_ / denominator_))
                            : std::nullopt;
  }

 private:
  double numerator_ = 0, denominator_ = 0;
};

Measures MeasuresOf(const Units& units) {
  Mean residual, tracking, intent, action, clipped, distance;
  PooledRatio residual_pooled, intent_pooled;
  for (const UnitResult* unit : units) {
    for (const EpisodeRow& row : unit->episodes) {
      residual.Add(row.residual);
      tracking.Add(row.residual_tracking);
      intent.Add(row.intent);
      action.Add(row.mean_abs_action);
      clipped.Add(row.clipped_share);
      residual_pooled.Add(row.eta_sq, row.a_sq);
      intent_pooled.Add(row.intent_eta_sq, row.intent_a_sq);
    }
    if (!unit->episodes.empty()) distance.Add(unit->episodes.back().adapter_distance);
  }
  return {residual.value(),      residual_pooled.value(), tracking.value(), intent.value(),
          intent_pooled.value(), action.value(),          clipped.value(),  distance.value()};
}

// Means over cells, field by field.
Measures MeanMeasures(const std::vector<Measures>& all) {
  Measures mean;
  for (const auto field :
       {&Measures::residual_mean, &Measures::residual_pooled, &Measures::tracking_mean,
        &Measures::intent_mean, &Measures::intent_pooled, &Measures::mean_abs_action,
        &Measures::clipped_share, &Measures::adapter_distance}) {
    Mean m;
    for (const Measures& measures : all) m.Add(measures.*field);
    mean.*field = m.value();
  }
  return mean;
}

// The pairs of one scenario, appended to `observations` with the stratum given; counts go to
// `comparison`.
void AddPairs(const Units& method, const Units& base, int stratum,
              std::vector<EpisodeValue>& observations, Comparison& comparison) {
  // suite, seed, task, episode
  std::map<std::tuple<std::string, int64_t, int, int>, bool> base_success;
  for (const UnitResult* unit : base) {
    for (const EpisodeRow& row : unit->episodes) {
      base_success[{unit->config.suite, unit->config.seed, row.task, row.episode}] = row.success;
    }
  }
  for (const UnitResult* unit : method) {
    for (const EpisodeRow& row : unit->episodes) {
      const auto pair =
          base_success.find({unit->config.suite, unit->config.seed, row.task, row.episode});
      if (pair == base_success.end()) continue;
      ++comparison.pairs;
      comparison.plus += row.success && !pair->second;
      comparison.minus += !row.success && pair->second;
      observations.push_back({unit->config.suite, row.task, row.initial_state, stratum,
                              static_cast<double>(row.success) - pair->second});
    }
  }
}

Cell MakeCell(const Units& units) {
  Cell cell;
  cell.units = static_cast<int>(units.size());
  for (const UnitResult* unit : units) {
    int updates = 0;
    for (const EpisodeRow& row : unit->episodes) {
      ++cell.n;
      cell.successes += row.success;
      updates = std::max(updates, row.updates);
    }
    cell.updates += updates;
    cell.adapts = cell.adapts || unit->config.method.adapt;
  }
  cell.wilson = WilsonInterval(cell.successes, cell.n);
  cell.measures = MeasuresOf(units);
  return cell;
}

// Scenarios and methods of a table, each in canonical order.
using Grid = std::map<std::string, std::map<std::string, Units>>;  // scenario -> method -> units

AverageCell MakeAverage(const SuccessTable& table, const Grid& grid, const std::string& method,
                        int replicates, const std::string& label) {
  AverageCell average;
  std::vector<EpisodeValue> successes, differences;
  std::vector<Measures> measures;
  Comparison comparison;
  int stratum = 0;
  for (const ScenarioRow& row : table.rows) {
    const auto cell = row.cells.find(method);
    if (row.scenario == "clean" || cell == row.cells.end()) continue;
    const auto& by_method = grid.at(row.scenario);
    for (const UnitResult* unit : by_method.at(method)) {
      for (const EpisodeRow& episode : unit->episodes) {
        successes.push_back({unit->config.suite, episode.task, episode.initial_state, stratum,
                             static_cast<double>(episode.success)});
      }
    }
    if (method != "base" && by_method.count("base")) {
      AddPairs(by_method.at(method), by_method.at("base"), stratum, differences, comparison);
    }
    average.adapts = average.adapts || cell->second.adapts;
    average.updates += cell->second.updates;
    measures.push_back(cell->second.measures);
    ++stratum;
  }
  average.success = BootstrapEpisodes(successes, replicates, label + "/average");
  average.measures = MeanMeasures(measures);
  if (comparison.pairs > 0) {
    comparison.difference =
        BootstrapEpisodes(differences, replicates, label + "/average difference");
    average.versus_base = comparison;
  }
  return average;
}

SuccessTable MakeTable(const Units& units, const std::string& policy, int severity,
                       const std::string& suite, int replicates) {
  SuccessTable table;
  table.policy = policy;
  table.severity = severity;
  table.suite = suite;
  Grid grid;
  std::set<std::string> methods_present;
  std::vector<std::string> suites;
  for (const UnitResult* unit : units) {
    grid[unit->config.scenario][unit->config.method.method].push_back(unit);
    methods_present.insert(unit->config.method.method);
    const SuiteInfo* info = FindSuite(unit->config.suite);
    const std::string title = info == nullptr ? unit->config.suite : info->title;
    if (std::find(suites.begin(), suites.end(), title) == suites.end()) suites.push_back(title);
  }
  table.title = absl::StrJoin(suites, ", ");
  for (const std::string& method : MethodNames()) {
    if (methods_present.count(method)) table.methods.push_back(method);
  }
  const std::string label = absl::StrCat(policy, "/L", severity, "/", suite);
  // The built-in ones in their order, then scenario files.
  std::vector<std::string> scenarios = ScenarioNames();
  for (const auto& [scenario, by_method] : grid) {
    if (IsScenarioFile(scenario)) scenarios.push_back(scenario);
  }
  for (const std::string& scenario : scenarios) {
    const auto by_method = grid.find(scenario);
    if (by_method == grid.end()) continue;
    ScenarioRow row{scenario, ScenarioTitle(scenario), {}};
    for (const auto& [method, cell_units] : by_method->second) {
      Cell cell = MakeCell(cell_units);
      if (method != "base" && by_method->second.count("base")) {
        Comparison comparison;
        std::vector<EpisodeValue> differences;
        AddPairs(cell_units, by_method->second.at("base"), 0, differences, comparison);
        comparison.difference = BootstrapEpisodes(differences, replicates,
                                                  absl::StrCat(label, "/", scenario, "/", method));
        if (comparison.pairs > 0) cell.versus_base = comparison;
      }
      row.cells.emplace(method, std::move(cell));
    }
    table.rows.push_back(std::move(row));
  }
  if (table.rows.size() > 1 || (!table.rows.empty() && table.rows[0].scenario != "clean")) {
    for (const std::string& method : table.methods) {
      table.averages.emplace(
          method, MakeAverage(table, grid, method, replicates, absl::StrCat(label, "/", method)));
    }
  }
  return table;
}

CurveSet MakeCurves(const Units& units, const std::string& policy, int severity) {
  CurveSet set;
  set.policy = policy;
  set.severity = severity;
  for (const std::string& method : MethodNames()) {
    Units chosen;
    size_t length = 0;
    for (const UnitResult* unit : units) {
      if (unit->config.method.method != method || unit->config.scenario == "clean") continue;
      chosen.push_back(unit);
      length = std::max(length, unit->episodes.size());
      set.episodes_per_task = unit->config.episodes;
    }
    if (chosen.empty()) continue;
    AdaptationCurve curve;
    curve.method = method;
    curve.units = static_cast<int>(chosen.size());
    for (size_t i = 0; i < length; ++i) {
      Mean success, residual, action, clipped, distance;
      for (const UnitResult* unit : chosen) {
        if (i >= unit->episodes.size()) continue;
        const EpisodeRow& episode = unit->episodes[i];
        success.Add(episode.success ? 1.0 : 0.0);
        residual.Add(episode.residual);
        action.Add(episode.mean_abs_action);
        clipped.Add(episode.clipped_share);
        distance.Add(episode.adapter_distance);
      }
      curve.success.push_back(success.value().value_or(kNaN));
      curve.residual.push_back(residual.value().value_or(kNaN));
      curve.mean_abs_action.push_back(action.value().value_or(kNaN));
      curve.clipped_share.push_back(clipped.value().value_or(kNaN));
      curve.adapter_distance.push_back(distance.value().value_or(kNaN));
    }
    set.curves.push_back(std::move(curve));
  }
  return set;
}

}  // namespace

std::string ScenarioTitle(const std::string& scenario) {
  const absl::StatusOr<Scenario> row = MakeScenario(scenario, 5);
  return row.ok() ? row->title : ScenarioLabel(scenario);
}

std::string MethodColor(const std::string& method) {
  static const auto& colors = *new std::map<std::string, std::string>{
      {"base", "#6b7280"},         {"ours", "#0072b2"},
      {"ours_intent", "#d55e00"},  {"ours_nominal", "#009e73"},
      {"gain", "#e69f00"},         {"null", "#cc79a7"},
      {"direct", "#56b4e9"},       {"no_residual", "#8b5cf6"},
      {"no_anchor", "#a16207"},    {"shuffled_instruction", "#be123c"},
      {"blank_images", "#0f766e"}, {"frozen_state", "#4d7c0f"}};
  const auto color = colors.find(method);
  return color == colors.end() ? "#334155" : color->second;
}

std::string MethodTitle(const std::string& method) {
  static const auto& titles =
      *new std::map<std::string, std::string>{{"base", "Base"},
                                              {"ours", "Ours"},
                                              {"ours_intent", "Ours, target intent"},
                                              {"ours_nominal", "Ours, target nominal"},
                                              {"gain", "Gain control"},
                                              {"null", "Null control"},
                                              {"direct", "Direct subtraction"},
                                              {"no_residual", "Ours w/o residual"},
                                              {"no_anchor", "Ours w/o anchor"},
                                              {"shuffled_instruction", "Shuffled instruction"},
                                              {"blank_images", "Blank images"},
                                              {"frozen_state", "Frozen state"}};
  const auto title = titles.find(method);
  return title == titles.end() ? method : title->second;
}

double PercentagePoints(double fraction) {
  return std::abs(fraction) < 0.0005 ? 0.0 : 100 * fraction;
}

std::string UpdatesText(bool adapts, int updates) {
  if (!adapts) return "-";
  return updates == 0 ? "not adapted" : absl::StrCat(updates);
}

Summary Summarise(const RunData& run, int bootstrap_replicates) {
  Summary summary;
  summary.replicates = bootstrap_replicates;
  std::set<std::pair<std::string, int>> groups;  // policy, severity
  std::map<std::string, std::set<int>> levels;   // of scenarios that have several
  for (const UnitResult& unit : run.units) {
    summary.episodes += static_cast<int>(unit.episodes.size());
    if (!SameAtEveryLevel(unit.config.scenario))
      levels[unit.config.policy].insert(unit.config.severity);
  }
  for (const UnitResult& unit : run.units) {
    const std::set<int>& of_policy = levels[unit.config.policy];
    if (of_policy.empty()) groups.insert({unit.config.policy, unit.config.severity});
    for (const int severity : of_policy) groups.insert({unit.config.policy, severity});
  }
  for (const auto& [policy, severity] : groups) {
    Units units;
    std::vector<std::string> suites;
    for (const UnitResult& unit : run.units) {
      if (unit.config.policy != policy) continue;
      if (unit.config.severity != severity && !SameAtEveryLevel(unit.config.scenario)) continue;
      units.push_back(&unit);
      if (std::find(suites.begin(), suites.end(), unit.config.suite) == suites.end())
        suites.push_back(unit.config.suite);
    }
    const std::string label = PolicyLabel(policy);
    summary.tables.push_back(MakeTable(units, label, severity, "", bootstrap_replicates));
    if (suites.size() > 1) {
      for (const std::string& suite : suites) {
        Units of_suite;
        std::copy_if(units.begin(), units.end(), std::back_inserter(of_suite),
                     [&](const UnitResult* unit) { return unit->config.suite == suite; });
        summary.tables.push_back(MakeTable(of_suite, label, severity, suite, bootstrap_replicates));
      }
    }
    CurveSet curves = MakeCurves(units, label, severity);
    if (!curves.curves.empty()) summary.curves.push_back(std::move(curves));
  }
  return summary;
}

}  // namespace robostress
