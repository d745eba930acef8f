#include "eval/paper/paper_results.h"

#include <algorithm>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/embedded_policies.h"
#include "common/suites.h"
#include "eval/report/severity_section.h"
#include "eval/statistics/comparison.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/paired_tests.h"
#include "eval/statistics/summary.h"

namespace robostress {
namespace {

Interval Percent(const Interval& interval) { return {100 * interval.low, 100 * interval.high}; }

// A value of every episode; nullopt where an episode has none.
std::optional<double> ValueOf(const EpisodeRow& row, PaperMeasure measure) {
  if (measure == PaperMeasure::kSuccess) return row.success ? 1.0 : 0.0;
  return row.residual;
}

// With its group where a table has the same columns for several.
std::string TitleOf(const PaperColumn& column) {
  return column.group.empty() ? column.title : absl::StrCat(column.group, ": ", column.title);
}

class Filler {
 public:
  Filler(const PaperTable& table, const PaperProtocol& protocol, const RunData& run, int replicates)
      : table_(table), protocol_(protocol), units_(CountedUnits(run)), replicates_(replicates) {}

  bool IsMissing(const PaperColumn& column) const {
    return protocol_.PolicyOf(column.role).empty();
  }

  // `part` of a row: a scenario, or a suite.
  Units UnitsIn(const std::string& part, const PaperColumn& column) const {
    const std::string& scenario = table_.suites.empty() ? part : column.scenario;
    Units units;
    for (const UnitResult* unit : units_) {
      const UnitConfig& c = unit->config;
      if (c.scenario == scenario && (table_.suites.empty() || c.suite == part) &&
          c.method->method == column.method &&
          PolicyLabel(c.policy) == PolicyLabel(protocol_.PolicyOf(column.role)) &&
          (c.severity == column.severity || SameAtEveryLevel(scenario)))
        units.push_back(unit);
    }
    return units;
  }

  // One stratum per scenario or suite; empty when one of them has no unit yet.
  FilledCell Cell(const std::vector<std::string>& scenarios, const PaperColumn& column) const {
    FilledCell cell;
    std::vector<EpisodeValue> values;
    std::vector<Units> strata;
    int successes = 0, updates = 0;
    bool adapts = false;
    for (const std::string& scenario : scenarios) {
      const Units units = UnitsIn(scenario, column);
      // An average over other scenarios than its neighbours' would mislead.
      if (units.empty()) return FilledCell();
      const int stratum = static_cast<int>(strata.size());
      strata.push_back(units);
      for (const UnitResult* unit : units) {
        adapts = adapts || unit->config.method->adapts();
        if (!unit->episodes.empty()) updates += unit->episodes.back().updates;
        for (const EpisodeRow& row : unit->episodes) {
          const std::optional<double> value = ValueOf(row, table_.measure);
          if (!value) continue;
          successes += row.success;
          values.push_back({unit->config.suite, row.task, row.initial_state, stratum, *value});
        }
      }
    }
    cell.n = static_cast<int>(values.size());
    if (values.empty()) return cell;
    const bool wilson = scenarios.size() == 1 && table_.measure == PaperMeasure::kSuccess;
    const BootstrapResult result =
        BootstrapEpisodes(values, wilson ? 0 : replicates_,
                          absl::StrCat("paper/", table_.name, "/", absl::StrJoin(scenarios, "+"),
                                       "/", TitleOf(column)),
                          ClusteringOf(strata));
    cell.value = 100 * result.estimate;
    cell.interval = Percent(wilson ? WilsonInterval(successes, cell.n) : result.interval);
    if (adapts) cell.note = updates == 0 ? "not adapted" : absl::StrCat(updates, " updates");
    return cell;
  }

  std::optional<Comparison> Contrast(const std::vector<std::string>& scenarios,
                                     const PaperContrast& contrast) const {
    const PaperColumn &method = table_.columns[contrast.column],
                      &reference = table_.columns[contrast.reference];
    if (IsMissing(method) || IsMissing(reference)) return std::nullopt;
    std::vector<PairedUnits> strata;
    for (const std::string& scenario : scenarios) {
      strata.push_back({UnitsIn(scenario, method), UnitsIn(scenario, reference)});
      if (strata.back().method.empty() || strata.back().reference.empty()) return std::nullopt;
    }
    return CompareOnPairs(strata, replicates_,
                          absl::StrCat("paper/", table_.name, "/", absl::StrJoin(scenarios, "+"),
                                       "/", TitleOf(method), " - ", reference.title));
  }

 private:
  const PaperTable& table_;
  const PaperProtocol& protocol_;
  const Units units_;
  const int replicates_;
};

std::vector<std::string> WithoutClean(std::vector<std::string> scenarios) {
  scenarios.erase(std::remove(scenarios.begin(), scenarios.end(), "clean"), scenarios.end());
  return scenarios;
}

// Title and scenarios of each row.
std::vector<std::pair<std::string, std::vector<std::string>>> RowsOf(const PaperTable& table) {
  std::vector<std::pair<std::string, std::vector<std::string>>> rows;
  for (const std::string& suite : table.suites) {
    const SuiteInfo* info = FindSuite(suite);
    rows.push_back({info == nullptr ? suite : info->title, {suite}});
  }
  if (!table.suites.empty()) {
    if (table.with_average) rows.push_back({"Average", table.suites});
    return rows;
  }
  if (!table.only_average) {
    for (const std::string& scenario : table.scenarios)
      rows.push_back({ScenarioTitle(scenario), {scenario}});
  }
  if (table.only_average || table.with_average)
    rows.push_back({"Average", WithoutClean(table.scenarios)});
  return rows;
}

std::string ContrastText(const std::optional<Comparison>& c) {
  if (!c) return "-";
  const Interval& interval = c->difference.interval;
  return absl::StrCat(absl::StrFormat("%+.1f", PercentagePoints(c->difference.estimate)),
                      std::isfinite(interval.low)
                          ? absl::StrFormat(" [%+.1f, %+.1f]", PercentagePoints(interval.low),
                                            PercentagePoints(interval.high))
                          : "",
                      " +", c->plus, "/-", c->minus, ", p ", PValueText(c->p_value), ", Holm ",
                      PValueText(c->p_holm));
}

TextRows Differences(const PaperTable& table, const Filler& filler) {
  const auto rows = RowsOf(table);
  // [row][contrast]
  std::vector<std::vector<std::optional<Comparison>>> all;
  for (const auto& [title, scenarios] : rows) {
    all.emplace_back();
    for (const PaperContrast& contrast : table.contrasts)
      all.back().push_back(filler.Contrast(scenarios, contrast));
  }
  const auto correct = [](const std::vector<Comparison*>& family) {
    std::vector<double> p_values;
    for (const Comparison* c : family) p_values.push_back(c->p_value);
    const std::vector<double> adjusted = HolmAdjust(p_values);
    for (size_t i = 0; i < family.size(); ++i) family[i]->p_holm = adjusted[i];
  };
  // Each contrast over its scenarios; the averages among themselves.
  std::vector<Comparison*> averages;
  for (size_t c = 0; c < table.contrasts.size(); ++c) {
    std::vector<Comparison*> scenarios;
    for (size_t r = 0; r < rows.size(); ++r) {
      if (all[r][c]) (rows[r].first == "Average" ? averages : scenarios).push_back(&*all[r][c]);
    }
    correct(scenarios);
  }
  correct(averages);
  TextRows text = {{"Points [95 %] won/lost"}};
  for (const auto& [title, scenarios] : rows) text[0].push_back(title);
  for (size_t c = 0; c < table.contrasts.size(); ++c) {
    text.push_back({absl::StrCat(TitleOf(table.columns[table.contrasts[c].column]), " - ",
                                 table.columns[table.contrasts[c].reference].title)});
    bool any = false;
    for (size_t r = 0; r < rows.size(); ++r) {
      any = any || all[r][c].has_value();
      text.back().push_back(ContrastText(all[r][c]));
    }
    if (!any) text.pop_back();
  }
  if (text.size() == 1) return {};
  // Scenarios go down, as in the table above.
  TextRows turned(text[0].size(), std::vector<std::string>(text.size()));
  for (size_t r = 0; r < text.size(); ++r) {
    for (size_t c = 0; c < text[r].size(); ++c) turned[c][r] = text[r][c];
  }
  return turned;
}

// "1 suite (Object), tasks 0, 1, 10 episodes per task, seed 0".
std::string OurProtocol(const PaperProtocol& protocol) {
  const SweepGrid& grid = protocol.grid;
  std::vector<std::string> titles;
  bool libero = false;
  for (const std::string& suite : grid.suites) {
    const SuiteInfo* info = FindSuite(suite);
    titles.push_back(info == nullptr ? suite : info->title);
    libero = libero || (info != nullptr && info->needs_libero);
  }
  return absl::StrCat(
      libero ? "LIBERO's suite" : "the embedded suite", titles.size() == 1 ? " " : "s ",
      absl::StrJoin(titles, ", "), ", ",
      grid.tasks.empty() ? "all tasks" : absl::StrCat("tasks ", absl::StrJoin(grid.tasks, ", ")),
      ", ", grid.episodes, " episodes per task from initial state ", grid.first_initial_state,
      ", seed", grid.seeds.size() == 1 ? " " : "s ", absl::StrJoin(grid.seeds, ", "));
}

std::vector<std::string> Notes(const PaperTable& table, const PaperProtocol& protocol,
                               const PublishedTable& published, const RunData& run,
                               const std::vector<PlannedUnit>& planned) {
  std::vector<std::string> notes = {absl::StrCat("Paper: ", published.protocol, ".")};
  if (protocol.grid.robot == "piper") {
    notes.push_back(absl::StrCat(
        "Ours: Pipers emulated in MuJoCo with wear profiles; a scripted expert instead of "
        "teleoperation; policy ",
        PolicyLabel(protocol.base), " in joint space. No real arm was used."));
  } else {
    notes.push_back(absl::StrCat("Ours: policy ", PolicyLabel(protocol.base), " on ",
                                 OurProtocol(protocol), ", MuJoCo 2.2."));
  }
  if (protocol.base == "nano") {
    notes.push_back(
        "nano has the graph of pi0 at a small fraction of its size and was trained on the embedded "
        "suites, which follow LIBERO's ideas and are not LIBERO: compare directions, not levels.");
    notes.push_back(
        "Learning rates and the gain control's factor were chosen on other initial states and a "
        "scenario of its own (adapter/README.md); the paper's learning rate is 1e-6.");
  }
  if (PolicyLabel(protocol.base) == kLiberoPolicy) {
    notes.push_back(
        "nano-libero has the graph of pi0 at a small fraction of its size: compare directions, not "
        "levels. Learning rates and the gain control's factor are nano's, chosen on the embedded "
        "suites; the paper's learning rate is 1e-6.");
  }
  if (protocol.papers_rate) notes.push_back("Adapters learn at the paper's rate, 1e-6.");
  std::vector<std::string> missing;
  for (const PaperColumn& column : table.columns) {
    if (protocol.PolicyOf(column.role).empty()) missing.push_back(column.title);
  }
  if (!missing.empty()) {
    notes.push_back(absl::StrCat("No weights were given for: ", absl::StrJoin(missing, ", "),
                                 " (--dr-weights, --robust-weights, --cloning-weights)."));
  }
  const size_t unfinished = planned.size() - run.units.size();
  if (unfinished > 0) {
    notes.push_back(absl::StrCat(unfinished, " of ", planned.size(),
                                 " planned units are not finished and enter no number; running the "
                                 "plan completes them."));
  }
  if (!table.contrasts.empty()) {
    notes.push_back(
        "Differences pair episodes of equal suite, seed, task and initial state; intervals: "
        "cluster bootstrap, over tasks where a method of the two carries something from episode to "
        "episode, otherwise over (task, initial state); p: signs of a cluster's differences "
        "flipped together; Holm: each difference over its scenarios, the averages among "
        "themselves.");
  }
  return notes;
}

}  // namespace

RunData UnitsOf(const RunData& run, const std::vector<PlannedUnit>& planned) {
  std::set<std::string> ids;
  for (const PlannedUnit& unit : planned) ids.insert(unit.id);
  RunData chosen = run;
  chosen.unfinished.clear();
  std::set<std::string> finished;
  chosen.units.clear();
  for (const UnitResult& unit : run.units) {
    if (!ids.count(unit.id)) continue;
    finished.insert(unit.id);
    chosen.units.push_back(unit);
  }
  for (const std::string& id : ids) {
    if (!finished.count(id)) chosen.unfinished.push_back(id);
  }
  return chosen;
}

void AddPublished(const PublishedTable& published, const std::vector<std::string>& rows,
                  FilledTable& table) {
  for (const PublishedGroup& group : published.groups) {
    table.groups.push_back({group.title, true, group.columns});
    for (size_t r = 0; r < table.rows.size(); ++r) {
      const int at = published.RowOf(rows[r]);
      for (size_t c = 0; c < group.columns.size(); ++c) {
        FilledCell cell;
        if (at >= 0 && std::isfinite(group.values[at][c])) cell.value = group.values[at][c];
        table.rows[r].cells.push_back(cell);
      }
    }
  }
}

FilledTable FillPaperTable(const PaperTable& table, const PaperProtocol& protocol,
                           const RunData& run, const std::vector<PlannedUnit>& planned,
                           int bootstrap_replicates) {
  const PublishedTable& published = *FindPublished(table.name);
  const Filler filler(table, protocol, run, bootstrap_replicates);
  FilledTable filled;
  filled.name = table.name;
  filled.label = published.label;
  filled.caption = published.caption;
  std::vector<std::string> keys;  // of rows, in the published table
  for (const auto& [title, scenarios] : RowsOf(table)) {
    const bool average = title == "Average";
    filled.rows.push_back({title, average, {}});
    keys.push_back(average                ? "average"
                   : table.suites.empty() ? scenarios.front()
                                          : table.row_keys[filled.rows.size() - 1]);
  }
  if (!table.suites.empty()) filled.row_heading = "Task";
  for (const bool control : {false, true}) {
    FilledGroup group{control ? "beside the paper" : PolicyLabel(protocol.base), false, {}};
    for (const PaperColumn& column : table.columns) {
      if (column.control != control || filler.IsMissing(column)) continue;
      if (!column.group.empty() && column.group != group.title) {
        if (!group.columns.empty()) filled.groups.push_back(group);
        group = {column.group, false, {}};
      }
      group.columns.push_back(column.title);
      const auto rows = RowsOf(table);
      for (size_t r = 0; r < rows.size(); ++r)
        filled.rows[r].cells.push_back(filler.Cell(rows[r].second, column));
    }
    if (!group.columns.empty()) filled.groups.push_back(group);
    // Between the paper's columns and the controls, which it does not have.
    if (!control) AddPublished(published, keys, filled);
  }
  // Columns of one level or another do not compete.
  const bool one_level = std::all_of(
      table.columns.begin(), table.columns.end(),
      [&](const PaperColumn& column) { return column.severity == table.columns[0].severity; });
  if (table.measure == PaperMeasure::kSuccess && one_level) MarkBest(filled);
  filled.differences = Differences(table, filler);
  filled.notes = Notes(table, protocol, published, run, planned);
  if (table.name == "severity" && !run.units.empty()) {
    filled.figure =
        SeverityFigure(Summarise(run, bootstrap_replicates), PolicyLabel(protocol.base));
  }
  return filled;
}

}  // namespace robostress
