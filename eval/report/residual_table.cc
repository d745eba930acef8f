#include "eval/report/residual_table.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/plan/plan.h"
#include "eval/report/paper_values.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/summary.h"

namespace robostress {
namespace {

using Units = std::vector<const UnitResult*>;

constexpr int kPaperSeverity = 5;

absl::Status CheckHasLag(const UnitResult& unit) {
  for (const EpisodeRow& row : unit.episodes) {
    const char* missing = !row.residual            ? "residual"
                          : !row.a_sq              ? "a_sq"
                          : !row.lag_residual      ? "lag_residual"
                          : !row.residual_tracking ? "residual_tracking"
                                                   : nullptr;
    if (missing == nullptr) continue;
    return absl::FailedPreconditionError(absl::StrCat(
        "unit ", unit.id, ", task ", row.task, " episode ", row.episode, ": field ", missing,
        " is missing; the unit was not run by `robostress residual`: choose another --out"));
  }
  return absl::OkStatus();
}

// The measures of a set of rollouts, before they are averaged.
struct Rollouts {
  int n = 0, successes = 0, motionless = 0;
  std::vector<EpisodeValue> residual, lag, added, lag_share, tracking;

  void Add(const UnitResult& unit, const EpisodeRow& row, int stratum) {
    if (*row.a_sq <= 0 || *row.residual <= 0) {
      ++motionless;
      return;
    }
    ++n;
    successes += row.success;
    const auto value = [&](double v) {
      return EpisodeValue{unit.config.suite, row.task, row.initial_state, stratum, v};
    };
    residual.push_back(value(*row.residual));
    lag.push_back(value(*row.lag_residual));
    added.push_back(value(*row.residual - *row.lag_residual));
    lag_share.push_back(value(*row.lag_residual / *row.residual));
    tracking.push_back(value(*row.residual_tracking));
  }

  ResidualRow Average(const std::string& title, int replicates, const std::string& label) const {
    ResidualRow row;
    row.title = title;
    row.n = n;
    row.successes = successes;
    // One label: the measures are resampled alike.
    row.residual = BootstrapEpisodes(residual, replicates, label);
    row.lag = BootstrapEpisodes(lag, replicates, label);
    row.added = BootstrapEpisodes(added, replicates, label);
    row.lag_share = BootstrapEpisodes(lag_share, replicates, label);
    row.tracking = BootstrapEpisodes(tracking, replicates, label);
    return row;
  }
};

// A scenario at a level; scenarios that are equal at all levels have one.
struct ScenarioLevel {
  std::string scenario;
  int severity = kPaperSeverity;

  bool IsOfPaper() const { return severity == kPaperSeverity || SameAtEveryLevel(scenario); }
  std::string Title() const {
    return IsOfPaper() ? ScenarioTitle(scenario)
                       : absl::StrCat(ScenarioTitle(scenario), " L", severity);
  }
  bool operator==(const ScenarioLevel&) const = default;
};

std::vector<ScenarioLevel> LevelsOf(const Units& units) {
  std::vector<ScenarioLevel> levels;
  for (const UnitResult* unit : units) {
    const ScenarioLevel level{unit->config.scenario, unit->config.severity};
    if (std::find(levels.begin(), levels.end(), level) == levels.end()) levels.push_back(level);
  }
  return levels;
}

// True for the seven deployment scenarios at the paper's level, no more and no fewer.
bool AreThePapers(const std::vector<ScenarioLevel>& levels) {
  std::set<std::string> expected, present;
  for (const PaperRow& row : PaperRows()) expected.insert(row.scenario);
  expected.erase("clean");
  for (const ScenarioLevel& level : levels) {
    if (!level.IsOfPaper()) return false;
    present.insert(level.scenario);
  }
  return present == expected;
}

std::string SuiteTitles(const Units& units) {
  std::vector<std::string> titles;
  for (const UnitResult* unit : units) {
    const SuiteInfo* info = FindSuite(unit->config.suite);
    const std::string title = info == nullptr ? unit->config.suite : info->title;
    if (std::find(titles.begin(), titles.end(), title) == titles.end()) titles.push_back(title);
  }
  return absl::StrJoin(titles, ", ");
}

ResidualTable MakeTable(const Units& units, const std::string& label, int replicates) {
  const UnitConfig& first = units.front()->config;
  ResidualTable table{first.sim.goal_reference, PolicyLabel(first.policy), first.method->method,
                      SuiteTitles(units)};
  Rollouts worn;
  std::vector<ScenarioLevel> worn_levels;
  for (const ScenarioLevel& level : LevelsOf(units)) {
    Rollouts rollouts;
    const bool is_clean = level.scenario == "clean";
    for (const UnitResult* unit : units) {
      if (ScenarioLevel{unit->config.scenario, unit->config.severity} != level) continue;
      for (const EpisodeRow& row : unit->episodes) {
        rollouts.Add(*unit, row, 0);
        if (!is_clean) worn.Add(*unit, row, static_cast<int>(worn_levels.size()));
      }
    }
    if (!is_clean) worn_levels.push_back(level);
    table.motionless += rollouts.motionless;
    table.rows.push_back(
        rollouts.Average(level.Title(), replicates, absl::StrCat(label, "/", level.Title())));
    const PaperRow* paper = FindPaperRow(level.scenario);
    if (paper != nullptr && level.IsOfPaper()) table.rows.back().paper = paper->residual;
  }
  if (worn_levels.size() > 1) {
    table.rows.push_back(worn.Average("Average without Clean", replicates, label + "/average"));
    if (AreThePapers(worn_levels)) table.rows.back().paper = PaperAverage().residual;
  }
  return table;
}

// Units that share what `key` tells, groups in the order of the units.
template <class Key>
std::vector<Units> GroupBy(const Units& units, const Key& key) {
  std::vector<Units> groups;
  for (const UnitResult* unit : units) {
    const auto group = std::find_if(groups.begin(), groups.end(),
                                    [&](const Units& g) { return key(*g.front()) == key(*unit); });
    if (group == groups.end()) {
      groups.push_back({unit});
    } else {
      group->push_back(unit);
    }
  }
  return groups;
}

std::string PercentText(const BootstrapResult& result) {
  const std::string mean = absl::StrFormat("%.1f", 100 * result.estimate);
  if (!std::isfinite(result.interval.low)) return mean;
  return absl::StrFormat("%s [%.1f, %.1f]", mean, 100 * result.interval.low,
                         100 * result.interval.high);
}

std::string PointsText(const BootstrapResult& result) {
  const std::string mean = absl::StrFormat("%+.1f", PercentagePoints(result.estimate));
  if (!std::isfinite(result.interval.low)) return mean;
  return absl::StrFormat("%s [%+.1f, %+.1f]", mean, PercentagePoints(result.interval.low),
                         PercentagePoints(result.interval.high));
}

}  // namespace

std::string GoalReferenceName(GoalReference reference) {
  return reference == GoalReference::kAchieved ? "achieved" : "desired";
}

absl::StatusOr<std::vector<ResidualTable>> MakeResidualTables(const RunData& run,
                                                              int bootstrap_replicates) {
  Units units;
  for (const UnitResult& unit : run.units) {
    RS_RETURN_IF_ERROR(CheckHasLag(unit));
    units.push_back(&unit);
  }
  const auto label_of = [](const UnitResult& unit) {
    return absl::StrCat("residual/", GoalReferenceName(unit.config.sim.goal_reference), "/",
                        PolicyLabel(unit.config.policy), "/", unit.config.method->method);
  };
  const auto suite_of = [](const UnitResult& unit) { return unit.config.suite; };
  std::vector<ResidualTable> tables;
  for (const Units& group : GroupBy(units, label_of)) {
    const std::string label = label_of(*group.front());
    const std::vector<Units> suites = GroupBy(group, suite_of);
    if (suites.size() > 1) tables.push_back(MakeTable(group, label, bootstrap_replicates));
    for (const Units& suite : suites) {
      tables.push_back(MakeTable(suite, absl::StrCat(label, "/", suite_of(*suite.front())),
                                 bootstrap_replicates));
    }
  }
  return tables;
}

std::string ResidualHeading(const ResidualTable& table) {
  std::string text = absl::StrCat(
      "Residual ||eta|| / ||a|| (%), goal reference ", GoalReferenceName(table.goal_reference),
      ", policy ", table.policy, ", method ", table.method, ", suite",
      table.suites.find(',') == std::string::npos ? " " : "s ", table.suites);
  if (table.motionless > 0) {
    absl::StrAppend(&text, "; without ", table.motionless, " rollouts that had no motion");
  }
  return text;
}

std::vector<std::vector<std::string>> ResidualCells(const ResidualTable& table) {
  std::vector<std::vector<std::string>> cells = {{"Scenario", "n", "success", "residual", "lag",
                                                  "errors add", "lag share", "tracking scale",
                                                  "paper, pi0"}};
  for (const ResidualRow& row : table.rows) {
    cells.push_back({row.title, absl::StrCat(row.n),
                     row.n == 0 ? "-" : absl::StrFormat("%.0f", 100.0 * row.successes / row.n),
                     PercentText(row.residual), PercentText(row.lag), PointsText(row.added),
                     PercentText(row.lag_share), PercentText(row.tracking),
                     row.paper ? absl::StrFormat("%.1f", *row.paper) : "-"});
  }
  return cells;
}

}  // namespace robostress
