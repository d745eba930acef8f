#include "eval/report/store_comparison.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <deque>
#include <map>
#include <set>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/html_page.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "common/svg_plot.h"
#include "eval/plan/plan.h"
#include "eval/plan/titles.h"
#include "eval/report/html_numbers.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/paired_tests.h"
#include "eval/store/played_alike.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

constexpr int kMostNames = 6;  // in a note

// policy, severity, method, scenario's label; a scenario that is equal at all levels has level 0.
using CellKey = std::tuple<std::string, int, std::string, std::string>;

CellKey KeyOf(const UnitConfig& config) {
  return {PolicyLabel(config.policy), SameAtEveryLevel(config.scenario) ? 0 : config.severity,
          config.method->method, ScenarioLabel(config.scenario)};
}

// Cells in the order of the store's units.
std::vector<std::pair<CellKey, Units>> CellsOf(const RunData& run) {
  std::vector<std::pair<CellKey, Units>> cells;
  for (const UnitResult* unit : CountedUnits(run)) {
    const CellKey key = KeyOf(unit->config);
    auto cell = std::find_if(cells.begin(), cells.end(),
                             [&](const auto& entry) { return entry.first == key; });
    if (cell == cells.end()) cell = cells.insert(cells.end(), {key, {}});
    cell->second.push_back(unit);
  }
  return cells;
}

std::vector<EpisodeValue> Successes(const std::vector<Units>& strata) {
  std::vector<EpisodeValue> values;
  for (size_t stratum = 0; stratum < strata.size(); ++stratum) {
    for (const UnitResult* unit : strata[stratum]) {
      for (const EpisodeRow& row : unit->episodes)
        values.push_back({unit->config.suite, row.task, row.initial_state,
                          static_cast<int>(stratum), static_cast<double>(row.success)});
    }
  }
  return values;
}

std::set<std::pair<std::string, int>> TasksOf(const Units& units) {
  std::set<std::pair<std::string, int>> tasks;
  for (const UnitResult* unit : units) {
    for (const EpisodeRow& row : unit->episodes) tasks.insert({unit->config.suite, row.task});
  }
  return tasks;
}

// The units with the episodes of these tasks alone; what has none is left out. Copies go to `kept`.
Units OnTasks(const Units& units, const std::set<std::pair<std::string, int>>& tasks,
              std::deque<UnitResult>& kept) {
  Units result;
  for (const UnitResult* unit : units) {
    const auto elsewhere = [&](const EpisodeRow& row) {
      return tasks.count({unit->config.suite, row.task}) == 0;
    };
    if (std::any_of(unit->episodes.begin(), unit->episodes.end(), elsewhere)) {
      unit = &kept.emplace_back(*unit);
      std::vector<EpisodeRow>& rows = kept.back().episodes;
      rows.erase(std::remove_if(rows.begin(), rows.end(), elsewhere), rows.end());
    }
    if (!unit->episodes.empty()) result.push_back(unit);
  }
  return result;
}

int EpisodesIn(const Units& units) {
  int episodes = 0;
  for (const UnitResult* unit : units) episodes += static_cast<int>(unit->episodes.size());
  return episodes;
}

// One scenario, or several as the strata of an average.
StoreRow MakeRow(const std::vector<PairedUnits>& strata, int replicates, const std::string& label) {
  StoreRow row;
  std::vector<Units> first, second;
  for (const PairedUnits& stratum : strata) {
    second.push_back(stratum.method);
    first.push_back(stratum.reference);
  }
  const std::vector<EpisodeValue> a = Successes(first), b = Successes(second);
  row.n_first = static_cast<int>(a.size());
  row.n_second = static_cast<int>(b.size());
  row.first = BootstrapEpisodes(a, 0, label).estimate;
  row.second = BootstrapEpisodes(b, 0, label).estimate;
  row.paired = CompareOnPairs(strata, replicates, label);
  row.difference = row.paired ? row.paired->difference
                              : BootstrapUnpaired(b, a, replicates, label, ClusteringOf(strata));
  return row;
}

// "a, b, c and 4 more".
std::string Some(const std::vector<std::string>& names) {
  const size_t shown = std::min<size_t>(names.size(), kMostNames);
  std::string text = absl::StrJoin(names.begin(), names.begin() + shown, ", ");
  if (names.size() > shown) absl::StrAppend(&text, " and ", names.size() - shown, " more");
  return text;
}

std::map<std::string, const UnitResult*> ById(const RunData& run) {
  std::map<std::string, const UnitResult*> units;
  for (const UnitResult& unit : run.units) units.emplace(unit.id, &unit);
  return units;
}

// Names of scenario files that hold another scenario in the other store.
std::set<std::string> OtherScenarios(const RunData& first, const RunData& second) {
  const auto hashes = [](const RunData& run) {
    std::map<std::string, std::string> of_files;
    for (const UnitResult& unit : run.units) {
      if (!IsScenarioFile(unit.config.scenario)) continue;
      const auto [hash, fresh] = of_files.try_emplace(ScenarioLabel(unit.config.scenario));
      if (!fresh) continue;
      UnitConfig config = unit.config;
      for (config.severity = 1; config.severity <= 5; ++config.severity)
        hash->second += ScenarioHash(config);
    }
    return of_files;
  };
  const std::map<std::string, std::string> ours = hashes(first);
  std::set<std::string> others;
  for (const auto& [label, hash] : hashes(second)) {
    const auto found = ours.find(label);
    if (found != ours.end() && found->second != hash) others.insert(label);
  }
  return others;
}

// Lines of the configuration that differ: "method.gain: 1 -> 1.15" as "gain: 1 | gain: 1.15".
std::vector<std::string> ChangedLines(UnitConfig first, UnitConfig second) {
  for (UnitConfig* config : {&first, &second}) {
    config->scenario = ScenarioLabel(config->scenario);  // where a file lies is nothing
    config->policy = PolicyLabel(config->policy);
  }
  // Earlier versions did not note what LIBERO's own tasks were.
  if (first.libero_tasks.empty() || second.libero_tasks.empty())
    first.libero_tasks.clear(), second.libero_tasks.clear();
  const std::vector<std::string> a = absl::StrSplit(DumpConfig(first), '\n'),
                                 b = absl::StrSplit(DumpConfig(second), '\n');
  std::vector<std::string> changes;
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    if (a[i] != b[i]) changes.push_back(absl::StrCat("'", a[i], "' | '", b[i], "'"));
  }
  if (a.size() != b.size()) changes.push_back("lists of other lengths");
  return changes;
}

std::vector<std::string> Notes(const RunData& first, const RunData& second) {
  const auto a = ById(first), b = ById(second);
  std::vector<std::string> notes, only_first, only_second;
  std::set<std::string> models;
  std::map<std::string, int> configurations;  // changed lines -> units
  for (const auto& [id, unit] : a) {
    const auto other = b.find(id);
    if (other == b.end()) {
      only_first.push_back(id);
      continue;
    }
    const std::string model = TextAt(unit->provenance, "model_hash"),
                      other_model = TextAt(other->second->provenance, "model_hash");
    if (model != other_model) {
      models.insert(absl::StrCat(PolicyLabel(unit->config.policy), " (",
                                 model.empty() ? "not recorded" : model.substr(0, 12), " | ",
                                 other_model.empty() ? "not recorded" : other_model.substr(0, 12),
                                 ")"));
    }
    const auto changes = ChangedLines(unit->config, other->second->config);
    if (!changes.empty()) ++configurations[Some(changes)];
  }
  for (const auto& [id, unit] : b) {
    if (!a.count(id)) only_second.push_back(id);
  }
  const auto only = [&](const char* which, const std::vector<std::string>& ids) {
    if (!ids.empty())
      notes.push_back(absl::StrCat("Only in the ", which, ", not compared unit by unit: ",
                                   ids.size(), " units (", Some(ids), ")."));
  };
  only("first", only_first);
  only("second", only_second);
  if (!models.empty()) {
    notes.push_back(absl::StrCat("Other weights under the same policy name (first | second): ",
                                 absl::StrJoin(models, ", "), "."));
  }
  for (const auto& [changes, units] : configurations) {
    notes.push_back(
        absl::StrCat(units, " units have other configurations (first | second): ", changes, "."));
  }
  for (const auto& [which, run] : {std::pair("first", &first), std::pair("second", &second)}) {
    if (const std::string unpaired = UnpairedNoiseNote(*run); !unpaired.empty())
      notes.push_back(absl::StrCat("In the ", which, ": ", unpaired));
    if (!run->unfinished.empty())
      notes.push_back(absl::StrCat("Unfinished in the ", which,
                                   " and left out: ", run->unfinished.size(), " units."));
  }
  return notes;
}

void Correct(std::vector<StoreRow>& rows) {
  for (const bool averages : {false, true}) {
    std::vector<StoreRow*> family;
    std::vector<double> p_values;
    for (StoreRow& row : rows) {
      if (!row.paired || row.scenario.empty() != averages) continue;
      family.push_back(&row);
      p_values.push_back(row.paired->p_value);
    }
    const std::vector<double> adjusted = HolmAdjust(p_values);
    for (size_t i = 0; i < family.size(); ++i) family[i]->paired->p_holm = adjusted[i];
  }
}

std::string DifferencePlot(const StoreComparison& comparison) {
  std::vector<std::string> categories;
  IntervalSeries series{"second - first", "#0072b2", {}};
  double extent = 10;
  for (const StoreRow& row : comparison.rows) {
    categories.push_back(absl::StrCat(row.title, ", ", row.method, " (n = ",
                                      row.paired ? row.paired->pairs : row.n_first + row.n_second,
                                      row.paired ? " pairs)" : ", not paired)"));
    const Interval& interval = row.difference.interval;
    series.points.push_back(
        IntervalPoint{100 * row.difference.estimate, {100 * interval.low, 100 * interval.high}});
    for (const double end : {row.difference.estimate, interval.low, interval.high})
      extent = std::isfinite(end) ? std::max(extent, 100 * std::abs(end)) : extent;
  }
  IntervalPlotOptions options;
  options.x_max = 10 * std::ceil(extent / 10);
  options.x_min = -options.x_max;
  options.zero_line = true;
  options.x_label = "success, second - first [percentage points], 95 % intervals";
  return IntervalPlot(categories, {series}, options);
}

}  // namespace

absl::StatusOr<StoreComparison> CompareStores(const RunData& first, const RunData& second,
                                              int bootstrap_replicates) {
  StoreComparison result;
  result.first = first.dir;
  result.second = second.dir;
  const auto cells = CellsOf(first), others = CellsOf(second);
  // policy, severity, method -> strata of the average
  std::map<std::tuple<std::string, int, std::string>, std::vector<PairedUnits>> averages;
  int without_partner = 0, other_tasks = 0;
  std::deque<UnitResult> kept;  // of which a part is compared
  const std::set<std::string> other_scenarios = OtherScenarios(first, second);
  const std::string refused =
      other_scenarios.empty()
          ? ""
          : absl::StrCat("Not compared, because the file holds another scenario in the second: ",
                         absl::StrJoin(other_scenarios, ", "), ".");
  for (const auto& [key, units] : cells) {
    if (other_scenarios.count(std::get<3>(key)) > 0) continue;
    const auto other = std::find_if(others.begin(), others.end(),
                                    [&key = key](const auto& entry) { return entry.first == key; });
    if (other == others.end()) continue;
    // A rate over other tasks is no comparison.
    const Units mine = OnTasks(units, TasksOf(other->second), kept),
                theirs = OnTasks(other->second, TasksOf(units), kept);
    other_tasks +=
        EpisodesIn(units) + EpisodesIn(other->second) - EpisodesIn(mine) - EpisodesIn(theirs);
    if (mine.empty()) continue;
    const auto& [policy, severity, method, scenario] = key;
    StoreRow row =
        MakeRow({{theirs, mine}}, bootstrap_replicates,
                absl::StrCat("compare/", policy, "/L", severity, "/", method, "/", scenario));
    row.policy = policy, row.severity = severity, row.method = method, row.scenario = scenario;
    row.title = ScenarioTitle(units.front()->config.scenario);
    if (row.paired) {
      without_partner += row.n_first + row.n_second - 2 * row.paired->pairs;
      if (scenario != "clean") averages[{policy, severity, method}].push_back({theirs, mine});
    }
    result.rows.push_back(std::move(row));
  }
  if (result.rows.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat(first.dir, " and ", second.dir,
                     " have no cell in common (policy, severity, scenario, method, and a task of a "
                     "suite); nothing "
                     "can be compared",
                     refused.empty() ? "" : ". ", refused));
  }
  for (const auto& [key, strata] : averages) {
    if (strata.size() < 2) continue;
    const auto& [policy, severity, method] = key;
    StoreRow row = MakeRow(strata, bootstrap_replicates,
                           absl::StrCat("compare/", policy, "/L", severity, "/", method));
    row.policy = policy, row.severity = severity, row.method = method;
    row.title = absl::StrCat("Average of ", strata.size(), " scenarios without Clean");
    result.rows.push_back(std::move(row));
  }
  Correct(result.rows);
  result.notes = Notes(first, second);
  if (!refused.empty()) result.notes.insert(result.notes.begin(), refused);
  if (other_tasks > 0) {
    result.notes.push_back(
        absl::StrCat(other_tasks,
                     " episodes are of suites or tasks that the other store does not have with the "
                     "same policy, severity, scenario and method, and left out."));
  }
  if (without_partner > 0) {
    result.notes.push_back(absl::StrCat(without_partner,
                                        " episodes have no partner in the other store; paired "
                                        "differences leave them out, success rates do not."));
  }
  return result;
}

TextRows StoreCells(const StoreComparison& comparison) {
  TextRows rows = {{"Scenario", "policy", "level", "method", "n", "first", "second",
                    "second - first", "won/lost", "p", "p, Holm"}};
  for (const StoreRow& row : comparison.rows) {
    const Interval& interval = row.difference.interval;
    rows.push_back(
        {row.title, row.policy, row.severity == 0 ? "-" : absl::StrCat("L", row.severity),
         row.method, absl::StrCat(row.n_first, " | ", row.n_second),
         absl::StrFormat("%.1f", 100 * row.first), absl::StrFormat("%.1f", 100 * row.second),
         absl::StrCat(absl::StrFormat("%+.1f", PercentagePoints(row.difference.estimate)),
                      std::isfinite(interval.low)
                          ? absl::StrFormat(" [%+.1f, %+.1f]", PercentagePoints(interval.low),
                                            PercentagePoints(interval.high))
                          : ""),
         row.paired ? absl::StrCat("+", row.paired->plus, "/-", row.paired->minus, " of ",
                                   row.paired->pairs)
                    : "not paired",
         row.paired ? PValueText(row.paired->p_value) : "-",
         row.paired ? PValueText(row.paired->p_holm) : "-"});
  }
  return rows;
}

std::string StoreJson(const StoreComparison& comparison) {
  json rows = json::array();
  const auto number = [](double value) {
    return std::isfinite(value) ? json(value) : json(nullptr);
  };
  for (const StoreRow& row : comparison.rows) {
    json entry = {
        {"policy", row.policy},
        {"severity", row.severity == 0 ? json(nullptr) : json(row.severity)},
        {"method", row.method},
        {"scenario", row.scenario.empty() ? "average_without_clean" : row.scenario},
        {"n", {row.n_first, row.n_second}},
        {"success", {number(row.first), number(row.second)}},
        {"difference", number(row.difference.estimate)},
        {"interval", {number(row.difference.interval.low), number(row.difference.interval.high)}},
        {"paired", row.paired.has_value()}};
    if (row.paired) {
      entry["pairs"] = row.paired->pairs;
      entry["plus"] = row.paired->plus;
      entry["minus"] = row.paired->minus;
      entry["p_value"] = row.paired->p_value;
      entry["p_holm"] = number(row.paired->p_holm);
    }
    rows.push_back(entry);
  }
  const json report = {{"first", comparison.first},
                       {"second", comparison.second},
                       {"rows", rows},
                       {"notes", comparison.notes}};
  return report.dump(1) + "\n";
}

std::string StorePage(const StoreComparison& comparison) {
  std::string html = PageHead("RoboStress: two stores");
  absl::StrAppend(&html,
                  "<style>.wrap{max-width:1400px}</style>\n<header><div class=wrap><h1>Two stores "
                  "beside each other</h1><p>first: ",
                  EscapeXml(comparison.first), " \u00b7 second: ", EscapeXml(comparison.second),
                  "</p></div></header>\n<main class=wrap>\n<div class=scroll><table>");
  const TextRows rows = StoreCells(comparison);
  for (size_t r = 0; r < rows.size(); ++r) {
    html += r == 0 ? "<tr>" : comparison.rows[r - 1].scenario.empty() ? "<tr class=avg>" : "<tr>";
    for (size_t c = 0; c < rows[r].size(); ++c) {
      const std::string text = c >= 7 ? Minus(rows[r][c]) : rows[r][c];
      absl::StrAppend(&html, r == 0 ? "<th>" : "<td>", EscapeXml(text), r == 0 ? "</th>" : "</td>");
    }
    html += "</tr>\n";
  }
  absl::StrAppend(
      &html, "</table></div>\n", DifferencePlot(comparison),
      "<p class=note>Success in percent, differences in points with 95 % intervals: paired cluster "
      "bootstrap (over tasks where a method carries something from episode to episode, otherwise "
      "over initial states) where episodes pair (equal suite, seed, task, episode "
      "and initial state), otherwise both stores resampled apart. n: episodes, first | second. p: "
      "signs of a cluster's differences flipped together; Holm: over the paired scenarios, "
      "averages "
      "among themselves.</p>\n<ul>\n");
  for (const std::string& note : comparison.notes)
    absl::StrAppend(&html, "<li>", EscapeXml(note), "</li>\n");
  return html + "</ul>\n</main></body></html>\n";
}

absl::Status CompareRunDirectories(const std::string& first, const std::string& second,
                                   const std::string& out, int bootstrap_replicates) {
  RS_ASSIGN_OR_RETURN(const RunData a, LoadRun(first));
  RS_ASSIGN_OR_RETURN(const RunData b, LoadRun(second));
  RS_ASSIGN_OR_RETURN(const StoreComparison comparison, CompareStores(a, b, bootstrap_replicates));
  const std::string folder = out.empty() ? "runs/compare" : out;
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  const TextRows cells = StoreCells(comparison);
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.md", MarkdownTable(cells)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.csv", CsvTable(cells)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.json", StoreJson(comparison)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.html", StorePage(comparison)));
  std::printf("%s", AlignedTable(cells).c_str());
  for (const std::string& note : comparison.notes) std::printf("  - %s\n", note.c_str());
  std::printf("%s/compare.html\n", folder.c_str());
  return absl::OkStatus();
}

}  // namespace robostress
