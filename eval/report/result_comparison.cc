#include "eval/report/result_comparison.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/html_page.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"
#include "eval/report/html_numbers.h"
#include "eval/statistics/paired_tests.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

constexpr double kAbsent = std::numeric_limits<double>::quiet_NaN();
// Of a protocol: how many episodes, and from where, may differ between laboratories.
constexpr const char* kMayDiffer[] = {"episodes", "first_initial_state"};
// What earlier versions did not say of LIBERO's own suites.
constexpr char kSaidByNewer[] = "libero_tasks";

template <class Items, class Name>
auto Find(const Items& items, const Name& is) -> decltype(&items.front()) {
  const auto found = std::find_if(items.begin(), items.end(), is);
  return found == items.end() ? nullptr : &*found;
}

// "sim.stepping (fast | parity)" for every key that differs.
std::string OptionsThatDiffer(const std::map<std::string, std::string>& first,
                              const std::map<std::string, std::string>& second) {
  std::set<std::string> keys;
  for (const auto* options : {&first, &second})
    for (const auto& [key, value] : *options) keys.insert(key);
  std::vector<std::string> differ;
  for (const std::string& key : keys) {
    if (std::find(std::begin(kMayDiffer), std::end(kMayDiffer), key) != std::end(kMayDiffer))
      continue;
    const auto a = first.find(key), b = second.find(key);
    if (key == kSaidByNewer && (a == first.end() || b == second.end())) continue;
    const std::string left = a == first.end() ? "absent" : a->second,
                      right = b == second.end() ? "absent" : b->second;
    if (left != right) differ.push_back(absl::StrCat(key, " (", left, " | ", right, ")"));
  }
  return absl::StrJoin(differ, ", ");
}

// Why cells of two files under one name are not of one thing; empty where they are.
class Comparability {
 public:
  Comparability(const ResultFile& first, const ResultFile& second)
      : first_(first), second_(second) {}

  std::string Reason(const ResultCell& cell) const {
    if (const std::string why = Methods(cell.method); !why.empty()) return why;
    std::vector<std::string> suites = {cell.suite};
    if (cell.suite == "all") {
      if (Suites(first_) != Suites(second_))
        return absl::StrCat("other suites (", Suites(first_), " | ", Suites(second_), ")");
      suites.clear();
      for (const ResultProtocol& protocol : first_.protocols) suites.push_back(protocol.suite);
    }
    for (const std::string& suite : suites) {
      const auto of_suite = [&](const ResultProtocol& p) { return p.suite == suite; };
      const ResultProtocol *a = Find(first_.protocols, of_suite),
                           *b = Find(second_.protocols, of_suite);
      if (a == nullptr || b == nullptr) return absl::StrCat("no protocol of suite ", suite);
      if (const std::string differ = OptionsThatDiffer(a->options, b->options); !differ.empty())
        return absl::StrCat("other protocol of ", suite, ": ", differ);
    }
    const std::vector<std::string> scenarios =
        cell.is_mean() ? cell.scenarios : std::vector<std::string>{cell.scenario};
    for (const std::string& scenario : scenarios) {
      if (const std::string why = Scenarios(scenario, cell.severity); !why.empty()) return why;
    }
    return "";
  }

 private:
  static std::string Suites(const ResultFile& file) {
    std::set<std::string> names;
    for (const ResultProtocol& protocol : file.protocols) names.insert(protocol.suite);
    return absl::StrJoin(names, ", ");
  }
  std::string Methods(const std::string& name) const {
    const auto named = [&](const ResultMethod& m) { return m.name == name; };
    const ResultMethod *a = Find(first_.methods, named), *b = Find(second_.methods, named);
    if (a != nullptr && b != nullptr && a->sha256 == b->sha256) return "";
    return absl::StrCat("method ", name, " has other options");
  }
  std::string Scenarios(const std::string& name, int severity) const {
    // A mean's scenarios may be equal at every level.
    const auto named = [&](const ResultScenario& s) {
      return s.name == name && (s.severity == severity || s.severity == 0);
    };
    const ResultScenario *a = Find(first_.scenarios, named), *b = Find(second_.scenarios, named);
    if (a == nullptr || b == nullptr || a->sha256 != b->sha256)
      return absl::StrCat("other version of scenario ", name, " (its parameters differ)");
    if (a->sha256.empty() && first_.robostress != second_.robostress) {
      return absl::StrCat("scenario ", name, " is part of the program, and the versions differ (",
                          absl::StrJoin(first_.robostress, ", "), " | ",
                          absl::StrJoin(second_.robostress, ", "), ")");
    }
    return "";
  }

  const ResultFile &first_, &second_;
};

using CellName = std::tuple<std::string, std::string, int, std::string, std::string>;

// Suite, scenario, severity, method; of a mean its scenarios.
CellName NameOf(const ResultCell& cell) {
  return {cell.suite, cell.scenario, cell.severity, cell.method,
          absl::StrJoin(cell.scenarios, ",")};
}

std::string RowTitle(const std::string& suite, const std::string& scenario, int severity,
                     size_t scenarios) {
  return absl::StrCat(suite, ", ",
                      scenario.empty() ? absl::StrCat("mean of ", scenarios, " scenarios")
                                       : ScenarioTitle(scenario),
                      severity == 0 ? "" : absl::StrCat(" L", severity));
}

std::string CellTitle(const ResultCell& cell) {
  return absl::StrCat(RowTitle(cell.suite, cell.scenario, cell.severity, cell.scenarios.size()),
                      ", ", cell.method);
}

std::vector<ResultColumn> ColumnsOf(const std::vector<NamedResults>& labs) {
  std::vector<ResultColumn> columns;
  for (size_t i = 0; i < labs.size(); ++i) {
    for (const ResultPolicy& policy : labs[i].file.policies) {
      const bool alone = labs[i].file.policies.size() == 1;
      columns.push_back({alone ? labs[i].name : absl::StrCat(labs[i].name, ": ", policy.label), i,
                         policy.label, policy.noise_paired});
    }
  }
  return columns;
}

// Cells of a column, means last; a mean of one scenario is that scenario's cell again.
std::vector<ResultCell> CellsOf(const NamedResults& lab, const std::string& policy) {
  std::vector<ResultCell> cells;
  for (const auto* list : {&lab.file.results, &lab.file.means})
    for (const ResultCell& cell : *list)
      if (cell.policy == policy && cell.scenarios.size() != 1) cells.push_back(cell);
  return cells;
}

RateDifference Difference(const ResultCell& first, const ResultCell& second) {
  if (!first.is_mean()) return CompareRates(first.counts, second.counts);
  RateDifference difference{second.rate - first.rate, {kAbsent, kAbsent}, kAbsent};
  if (first.interval && second.interval)
    difference.interval =
        DifferenceInterval(first.rate, *first.interval, second.rate, *second.interval);
  return difference;
}

void CorrectAll(std::vector<ResultRow>& rows) {
  std::vector<double> p_values;
  for (const ResultRow& row : rows)
    for (const auto& difference : row.differences)
      p_values.push_back(difference ? difference->p_value : kAbsent);
  const std::vector<double> adjusted = HolmAdjust(p_values);
  size_t next = 0;
  for (ResultRow& row : rows)
    for (size_t c = 0; c < row.differences.size(); ++c) row.p_holm.push_back(adjusted[next++]);
}

void AddNotes(const std::vector<NamedResults>& labs, const std::vector<bool>& same,
              ResultComparison& result) {
  const NamedResults& first = labs[0];
  for (const NamedResults& lab : labs) {
    if (lab.file.robostress != first.file.robostress)
      result.notes.push_back(absl::StrCat(
          "Versions differ: ", first.name, " ", absl::StrJoin(first.file.robostress, ", "), ", ",
          lab.name, " ", absl::StrJoin(lab.file.robostress, ", "), "."));
    if (lab.file.mujoco != first.file.mujoco)
      result.notes.push_back(absl::StrCat("MuJoCo differs: ", first.name, " ", first.file.mujoco,
                                          ", ", lab.name, " ", lab.file.mujoco, "."));
    for (const std::string& note : lab.file.notes)
      result.notes.push_back(absl::StrCat(lab.name, ": ", note));
  }
  for (const ResultColumn& column : result.columns) {
    const auto labelled = [&](const ResultPolicy& p) { return p.label == column.policy; };
    const ResultPolicy& policy = *Find(labs[column.file].file.policies, labelled);
    result.notes.push_back(absl::StrCat(
        column.name, ": policy ", policy.label, ", model ",
        policy.model_hash.empty() ? "not recorded" : policy.model_hash.substr(0, 12),
        policy.server
            ? absl::StrCat(" (label and metadata of a server, dialect ", policy.server->dialect,
                           ", ", policy.server->reconnections, " reconnections)")
            : "",
        policy.noise_paired ? "." : ", sampling noise not paired."));
  }
  for (size_t i = 1; i < labs.size(); ++i)
    if (same[i])
      result.notes.push_back(absl::StrCat(labs[i].name, " and ", first.name,
                                          " are the same results: nothing is compared."));
}

// Which files are the first's again: no independent sample.
std::vector<bool> SameAsFirst(const std::vector<NamedResults>& labs) {
  std::vector<bool> same(labs.size());
  const std::string text = WriteResultFile(labs[0].file);
  for (size_t i = 1; i < labs.size(); ++i) same[i] = WriteResultFile(labs[i].file) == text;
  return same;
}

std::string RateText(const ResultCell& cell) {
  return absl::StrCat(absl::StrFormat("%.1f", 100 * cell.rate),
                      cell.interval ? absl::StrFormat(" [%.1f, %.1f]", 100 * cell.interval->low,
                                                      100 * cell.interval->high)
                                    : "");
}

std::string PointsText(const RateDifference& d) {
  return absl::StrCat(absl::StrFormat("%+.1f", PercentagePoints(d.estimate)),
                      std::isfinite(d.interval.low)
                          ? absl::StrFormat(" [%+.1f, %+.1f]", PercentagePoints(d.interval.low),
                                            PercentagePoints(d.interval.high))
                          : "");
}

}  // namespace

std::string ResultComparisonMethod() {
  return "Success in percent, differences in points, 95 % intervals. The laboratories share no "
         "episode, so nothing is paired: Newcombe's interval (method 10) and a score test, on n "
         "divided by the design effect of repeated initial states (Rao & Scott 1992). Where both "
         "began at the same initial states the interval is too wide, not too narrow. A mean over "
         "scenarios has the interval of its two bootstrap intervals, and no p. Holm: over all p of "
         "this table.";
}

absl::StatusOr<ResultComparison> CompareResults(const std::vector<NamedResults>& labs) {
  ResultComparison result;
  result.columns = ColumnsOf(labs);
  if (result.columns.size() < 2) {
    return absl::InvalidArgumentError(
        "one policy of one file: nothing to compare it with; give a second file or run directory");
  }
  const std::vector<bool> same = SameAsFirst(labs);
  const ResultColumn& reference = result.columns[0];
  std::map<CellName, size_t> row_of;
  for (const ResultCell& cell : CellsOf(labs[reference.file], reference.policy)) {
    ResultRow row{cell.suite, cell.scenario, cell.method, cell.scenarios, cell.severity, {}, {},
                  {}};
    row.cells.resize(result.columns.size());
    row.differences.resize(result.columns.size());
    row.cells[0] = cell;
    row_of.emplace(NameOf(cell), result.rows.size());
    result.rows.push_back(std::move(row));
  }
  for (size_t c = 1; c < result.columns.size(); ++c) {
    const ResultColumn& column = result.columns[c];
    const Comparability comparability(labs[reference.file].file, labs[column.file].file);
    std::set<CellName> theirs;
    for (const ResultCell& cell : CellsOf(labs[column.file], column.policy)) {
      theirs.insert(NameOf(cell));
      const auto row = row_of.find(NameOf(cell));
      std::string why =
          row == row_of.end()
              ? absl::StrCat(reference.name,
                             cell.is_mean() ? " has no mean of these scenarios at this severity"
                                            : " has no such suite, scenario, severity and method")
              : comparability.Reason(cell);
      if (!why.empty()) {
        result.refused.push_back(absl::StrCat(column.name, ", ", CellTitle(cell), ": ", why));
        continue;
      }
      ResultRow& found = result.rows[row->second];
      if (!same[column.file]) found.differences[c] = Difference(*found.cells[0], cell);
      found.cells[c] = cell;
    }
    for (const auto& [name, index] : row_of) {
      if (theirs.count(name) == 0)
        result.refused.push_back(
            absl::StrCat(column.name, " lacks ", CellTitle(*result.rows[index].cells[0])));
    }
  }
  result.rows.erase(std::remove_if(result.rows.begin(), result.rows.end(),
                                   [](const ResultRow& row) {
                                     return std::none_of(
                                         row.cells.begin() + 1, row.cells.end(),
                                         [](const auto& cell) { return cell.has_value(); });
                                   }),
                    result.rows.end());
  if (result.rows.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat("no result is comparable:\n  ", absl::StrJoin(result.refused, "\n  ")));
  }
  CorrectAll(result.rows);
  AddNotes(labs, same, result);
  return result;
}

TextRows ResultCells(const ResultComparison& comparison) {
  TextRows rows = {{"Suite, scenario", "method", "of", "n", "success", "- first", "p", "p, Holm"}};
  for (const ResultRow& row : comparison.rows) {
    for (size_t c = 0; c < row.cells.size(); ++c) {
      if (!row.cells[c]) continue;
      const auto& difference = row.differences[c];
      rows.push_back(
          {c == 0 ? RowTitle(row.suite, row.scenario, row.severity, row.scenarios.size()) : "",
           c == 0 ? row.method : "", comparison.columns[c].name,
           absl::StrCat(row.cells[c]->counts.n), RateText(*row.cells[c]),
           difference ? PointsText(*difference) : "",
           difference ? PValueText(difference->p_value) : "",
           difference ? PValueText(row.p_holm[c]) : ""});
    }
  }
  return rows;
}

std::string ResultComparisonJson(const ResultComparison& comparison) {
  const auto number = [](double value) {
    return std::isfinite(value) ? json(value) : json(nullptr);
  };
  json columns = json::array(), rows = json::array();
  for (const ResultColumn& column : comparison.columns)
    columns.push_back(
        {{"name", column.name}, {"policy", column.policy}, {"noise_paired", column.noise_paired}});
  for (const ResultRow& row : comparison.rows) {
    json cells = json::array();
    for (size_t c = 0; c < row.cells.size(); ++c) {
      if (!row.cells[c]) {
        cells.push_back(nullptr);
        continue;
      }
      const ResultCell& cell = *row.cells[c];
      json entry = {{"n", cell.counts.n}, {"rate", cell.rate}, {"interval", nullptr}};
      if (cell.interval) entry["interval"] = {cell.interval->low, cell.interval->high};
      if (const auto& d = row.differences[c]) {
        entry["difference"] = number(d->estimate);
        entry["difference_interval"] = {number(d->interval.low), number(d->interval.high)};
        entry["p"] = number(d->p_value);
        entry["p_holm"] = number(row.p_holm[c]);
      }
      cells.push_back(entry);
    }
    rows.push_back({{"suite", row.suite},
                    {"scenario", row.scenario.empty() ? json(row.scenarios) : json(row.scenario)},
                    {"severity", row.severity == 0 ? json(nullptr) : json(row.severity)},
                    {"method", row.method},
                    {"cells", cells}});
  }
  const json all = {{"columns", columns},
                    {"rows", rows},
                    {"not_compared", comparison.refused},
                    {"notes", comparison.notes}};
  return all.dump(1) + "\n";
}

std::string ResultComparisonPage(const ResultComparison& comparison) {
  std::string html = PageHead("RoboStress: results of several laboratories");
  html +=
      "<style>.wrap{max-width:1400px}</style>\n<header><div class=wrap><h1>Results beside each "
      "other</h1></div></header>\n<main class=wrap>\n<div class=scroll><table>";
  const TextRows rows = ResultCells(comparison);
  for (size_t r = 0; r < rows.size(); ++r) {
    html += r > 0 && !rows[r][0].empty() ? "<tr class=avg>" : "<tr>";
    for (size_t c = 0; c < rows[r].size(); ++c) {
      const std::string text = c == 5 ? Minus(rows[r][c]) : rows[r][c];
      absl::StrAppend(&html, r == 0 ? "<th>" : "<td>", EscapeXml(text), r == 0 ? "</th>" : "</td>");
    }
    html += "</tr>\n";
  }
  absl::StrAppend(&html, "</table></div>\n<p class=note>", EscapeXml(ResultComparisonMethod()),
                  "</p>\n");
  const auto list = [&html](const char* title, const std::vector<std::string>& items) {
    if (items.empty()) return;
    absl::StrAppend(&html, "<h2>", title, "</h2>\n<ul>\n");
    for (const std::string& item : items)
      absl::StrAppend(&html, "<li>", EscapeXml(item), "</li>\n");
    html += "</ul>\n";
  };
  list("Not compared", comparison.refused);
  list("Notes", comparison.notes);
  return html + "</main></body></html>\n";
}

}  // namespace robostress
