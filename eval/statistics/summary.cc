#include "eval/statistics/summary.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/joint_errors/scenario_file.h"
#include "common/suites.h"
#include "eval/plan/plan.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/paired_tests.h"

namespace robostress {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

bool AllPairNoise(const Units& units) {
  return std::all_of(units.begin(), units.end(),
                     [](const UnitResult* unit) { return PairsNoise(*unit); });
}

Cell MakeCell(const Units& units) {
  Cell cell;
  cell.units = static_cast<int>(units.size());
  std::vector<EpisodeValue> outcomes;
  for (const UnitResult* unit : units) {
    int updates = 0;
    for (const EpisodeRow& row : unit->episodes) {
      ++cell.n;
      cell.successes += row.success;
      outcomes.push_back(
          {unit->config.suite, row.task, row.initial_state, 0, static_cast<double>(row.success)});
      updates = std::max(updates, row.updates);
    }
    cell.updates += updates;
    cell.adapts = cell.adapts || unit->config.method->adapts();
    cell.compensates = cell.compensates || unit->config.method->Compensates();
  }
  cell.clustered = RateOf(ClusterEpisodes(outcomes));
  cell.wilson =
      AllPairNoise(units) ? WilsonInterval(cell.successes, cell.n) : RateInterval(cell.clustered);
  cell.seeds = SpreadOverSeeds({units});
  cell.measures = MeasuresOf(units);
  return cell;
}

// Scenarios and methods of a table, each in canonical order.
using Grid = std::map<std::string, std::map<std::string, Units>>;  // scenario -> method -> units

// Units of the method and of another in each scenario; none where one of them lacks a scenario.
std::vector<PairedUnits> StrataOf(const Grid& grid, const std::vector<std::string>& scenarios,
                                  const std::string& method, const std::string& reference) {
  std::vector<PairedUnits> strata;
  for (const std::string& scenario : scenarios) {
    const auto& by_method = grid.at(scenario);
    if (by_method.count(method) == 0 || by_method.count(reference) == 0) return {};
    strata.push_back({by_method.at(method), by_method.at(reference)});
  }
  return strata;
}

Contrasts MakeContrasts(const Grid& grid, const std::vector<std::string>& scenarios,
                        const std::string& method, bool controls, int replicates,
                        const std::string& label) {
  Contrasts contrasts;
  if (method == "base") return contrasts;
  const std::vector<PairedUnits> base = StrataOf(grid, scenarios, method, "base");
  contrasts.versus_base = CompareOnPairs(base, replicates, label);
  if (!controls) return contrasts;
  for (const std::string control : {"gain", "null"}) {
    const std::optional<Comparison> comparison =
        CompareOnPairs(StrataOf(grid, scenarios, method, control), replicates,
                       absl::StrCat(label, " against ", control));
    if (comparison) contrasts.versus_control.emplace(control, *comparison);
  }
  contrasts.residual =
      CompareBeforeAfter(base, AdaptationMeasure::kResidual, replicates, label + " residual");
  contrasts.intent =
      CompareBeforeAfter(base, AdaptationMeasure::kIntent, replicates, label + " intent");
  return contrasts;
}

AverageCell MakeAverage(const SuccessTable& table, const Grid& grid, const std::string& method,
                        int replicates, const std::string& label) {
  AverageCell average;
  std::vector<EpisodeValue> successes;
  std::vector<Measures> measures;
  std::vector<Units> strata;
  std::vector<std::string> scenarios;
  for (const ScenarioRow& row : table.rows) {
    if (row.scenario == "clean") continue;
    scenarios.push_back(row.scenario);
    const auto cell = row.cells.find(method);
    if (cell == row.cells.end()) {
      average.missing.push_back(row.title);
      continue;
    }
    strata.push_back(grid.at(row.scenario).at(method));
    for (const UnitResult* unit : strata.back()) {
      for (const EpisodeRow& episode : unit->episodes) {
        successes.push_back({unit->config.suite, episode.task, episode.initial_state,
                             static_cast<int>(strata.size()) - 1,
                             static_cast<double>(episode.success)});
      }
    }
    average.n += cell->second.n;
    average.adapts = average.adapts || cell->second.adapts;
    average.compensates = average.compensates || cell->second.compensates;
    average.updates += cell->second.updates;
    measures.push_back(cell->second.measures);
  }
  if (!average.missing.empty()) {
    AverageCell none;
    none.missing = std::move(average.missing);
    none.success = {kNaN, {kNaN, kNaN}, 0};
    none.seeds = SpreadOverSeeds({});
    return none;
  }
  average.clustering = ClusteringOf(strata);
  average.success =
      BootstrapEpisodes(successes, replicates, label + "/average", average.clustering);
  average.seeds = SpreadOverSeeds(strata);
  average.measures = MeanMeasures(measures);
  average.contrasts =
      MakeContrasts(grid, scenarios, method, average.compensates && table.suite.empty(), replicates,
                    label + "/average difference");
  return average;
}

// The comparison with base (control empty) or with a control, where there is one.
Comparison* Find(Contrasts& contrasts, const std::string& control) {
  if (control.empty()) return contrasts.versus_base ? &*contrasts.versus_base : nullptr;
  const auto found = contrasts.versus_control.find(control);
  return found == contrasts.versus_control.end() ? nullptr : &found->second;
}

void Correct(const std::vector<Comparison*>& family) {
  std::vector<double> p_values;
  for (const Comparison* comparison : family) p_values.push_back(comparison->p_value);
  const std::vector<double> adjusted = HolmAdjust(p_values);
  for (size_t i = 0; i < family.size(); ++i) family[i]->p_holm = adjusted[i];
}

void CorrectForNumber(SuccessTable& table) {
  for (const std::string control : {"", "gain", "null"}) {
    std::vector<Comparison*> cells, averages;
    for (ScenarioRow& row : table.rows) {
      for (auto& [method, cell] : row.cells) {
        if (Comparison* c = Find(cell.contrasts, control)) cells.push_back(c);
      }
    }
    for (auto& [method, average] : table.averages) {
      if (Comparison* c = Find(average.contrasts, control)) averages.push_back(c);
    }
    Correct(cells);
    Correct(averages);
  }
}

SuccessTable MakeTable(const Units& units, const std::string& policy, int severity,
                       const std::string& suite, int replicates) {
  SuccessTable table;
  table.policy = policy;
  table.severity = severity;
  table.suite = suite;
  table.noise_paired = AllPairNoise(units);
  Grid grid;
  std::set<std::string> methods_present;
  std::vector<std::string> suites;
  for (const UnitResult* unit : units) {
    grid[ScenarioLabel(unit->config.scenario)][unit->config.method->method].push_back(unit);
    methods_present.insert(unit->config.method->method);
    const SuiteInfo* info = FindSuite(unit->config.suite);
    const std::string title = info == nullptr ? unit->config.suite : info->title;
    if (std::find(suites.begin(), suites.end(), title) == suites.end()) suites.push_back(title);
  }
  table.title = absl::StrJoin(suites, ", ");
  for (const std::string& method : MethodNames()) {
    if (methods_present.count(method)) table.methods.push_back(method);
  }
  const std::string label = absl::StrCat(policy, "/L", severity, "/", suite);
  // The built-in ones in their order, then arms and scenario files.
  std::vector<std::string> scenarios = ScenarioNames();
  const std::set<std::string> built_in(scenarios.begin(), scenarios.end());
  for (const auto& [scenario, by_method] : grid) {
    if (built_in.count(scenario) == 0) scenarios.push_back(scenario);
  }
  for (const std::string& scenario : scenarios) {
    const auto by_method = grid.find(scenario);
    if (by_method == grid.end()) continue;
    // Of a scenario file, where it lies.
    const std::string& place = by_method->second.begin()->second.front()->config.scenario;
    ScenarioRow row{scenario, ScenarioTitle(place), !SameAtEveryLevel(place), {}};
    for (const auto& [method, cell_units] : by_method->second) {
      Cell cell = MakeCell(cell_units);
      cell.contrasts = MakeContrasts(grid, {scenario}, method, cell.compensates && suite.empty(),
                                     replicates, absl::StrCat(label, "/", scenario, "/", method));
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
  CorrectForNumber(table);
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
      if (unit->config.method->method != method || unit->config.scenario == "clean") continue;
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
      int present = 0;
      for (const UnitResult* unit : chosen) {
        if (i >= unit->episodes.size()) continue;
        const EpisodeRow& episode = unit->episodes[i];
        ++present;
        success.Add(episode.success ? 1.0 : 0.0);
        residual.Add(episode.residual);
        action.Add(episode.mean_abs_action);
        clipped.Add(episode.clipped_share);
        distance.Add(episode.adapter_distance);
      }
      curve.episodes.push_back(present);
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

Summary Summarise(const RunData& run, int bootstrap_replicates) {
  Summary summary;
  summary.replicates = bootstrap_replicates;
  summary.noise_paired = UnpairedNoiseNote(run).empty();
  summary.papers_tasks = absl::c_all_of(
      run.units, [](const UnitResult& unit) { return IsLiberosOwn(unit.config.suite); });
  std::set<std::pair<std::string, int>> groups;  // policy, severity
  std::map<std::string, std::set<int>> levels;   // of scenarios that have several
  const Units counted = CountedUnits(run);
  for (const UnitResult* unit : counted) {
    summary.episodes += static_cast<int>(unit->episodes.size());
    if (!SameAtEveryLevel(unit->config.scenario))
      levels[PolicyLabel(unit->config.policy)].insert(unit->config.severity);
  }
  for (const UnitResult* unit : counted) {
    const std::string policy = PolicyLabel(unit->config.policy);
    const std::set<int>& of_policy = levels[policy];
    if (of_policy.empty()) groups.insert({policy, unit->config.severity});
    for (const int severity : of_policy) groups.insert({policy, severity});
  }
  for (const auto& [policy, severity] : groups) {
    Units units;
    std::vector<std::string> suites;
    for (const UnitResult* unit : counted) {
      const UnitConfig& config = unit->config;
      if (PolicyLabel(config.policy) != policy) continue;
      if (config.severity != severity && !SameAtEveryLevel(config.scenario)) continue;
      units.push_back(unit);
      if (std::find(suites.begin(), suites.end(), config.suite) == suites.end())
        suites.push_back(config.suite);
    }
    summary.tables.push_back(MakeTable(units, policy, severity, "", bootstrap_replicates));
    if (suites.size() > 1) {
      for (const std::string& suite : suites) {
        Units of_suite;
        std::copy_if(units.begin(), units.end(), std::back_inserter(of_suite),
                     [&](const UnitResult* unit) { return unit->config.suite == suite; });
        summary.tables.push_back(
            MakeTable(of_suite, policy, severity, suite, bootstrap_replicates));
      }
    }
    CurveSet curves = MakeCurves(units, policy, severity);
    if (!curves.curves.empty()) summary.curves.push_back(std::move(curves));
  }
  return summary;
}

}  // namespace robostress
