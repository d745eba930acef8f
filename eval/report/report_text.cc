#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/methods.h"
#include "common/unit/robots.h"
#include "eval/plan/titles.h"
#include "eval/report/paper_values.h"
#include "eval/report/report.h"
#include "eval/report/text_table.h"
#include "eval/store/played_alike.h"
#include "eval/store/served_policies.h"

namespace robostress {
namespace {

std::string Percent(double fraction) { return absl::StrFormat("%.1f", 100 * fraction); }
std::string OptionalPercent(const std::optional<double>& fraction) {
  return fraction ? Percent(*fraction) : "-";
}

std::string IntervalText(const Interval& interval) {
  if (!std::isfinite(interval.low)) return "[n/a]";
  return absl::StrFormat("[%.0f, %.0f]", 100 * interval.low, 100 * interval.high);
}

std::string DifferenceText(const Comparison& c) {
  const Interval& interval = c.difference.interval;
  const std::string ends = std::isfinite(interval.low)
                               ? absl::StrFormat("[%+.0f, %+.0f]", PercentagePoints(interval.low),
                                                 PercentagePoints(interval.high))
                               : "[n/a]";
  return absl::StrFormat("%+.1f %s +%d/-%d", PercentagePoints(c.difference.estimate), ends, c.plus,
                         c.minus);
}

std::string TableHeading(const SuccessTable& table) {
  return absl::StrCat("Success (%), policy ", table.policy, ", severity L", table.severity,
                      ", suite", table.title.find(',') == std::string::npos ? " " : "s ",
                      table.title, table.noise_paired ? "" : "; sampling noise not paired");
}

std::vector<std::vector<std::string>> SuccessRows(const SuccessTable& table) {
  std::vector<std::vector<std::string>> rows = {{"Scenario", "n"}};
  for (const std::string& method : table.methods) {
    rows[0].push_back(method);
    if (method != "base")
      rows[0].insert(
          rows[0].end(),
          {method == "ours" ? "ours - base" : absl::StrCat(method, " - base"), "updates"});
  }
  for (const ScenarioRow& row : table.rows) {
    CountRange counts;
    for (const auto& [method, cell] : row.cells) counts.Add(cell.n);
    std::vector<std::string> cells = {row.title, counts.Text()};
    for (const std::string& method : table.methods) {
      const auto found = row.cells.find(method);
      if (found == row.cells.end()) {
        cells.push_back("-");
        if (method != "base") cells.insert(cells.end(), {"-", "-"});
        continue;
      }
      const Cell& cell = found->second;
      cells.push_back(absl::StrCat(Percent(cell.rate()), " ", IntervalText(cell.wilson)));
      if (method == "base") continue;
      cells.push_back(cell.contrasts.versus_base ? DifferenceText(*cell.contrasts.versus_base)
                                                 : "-");
      cells.push_back(UpdatesText(cell.adapts, cell.updates));
    }
    rows.push_back(cells);
  }
  if (table.averages.empty()) return rows;
  CountRange counts;
  for (const auto& [method, average] : table.averages) counts.Add(average.n);
  std::vector<std::string> cells = {"Average without Clean", counts.Text()};
  for (const std::string& method : table.methods) {
    const AverageCell& average = table.averages.at(method);
    cells.push_back(std::isfinite(average.success.estimate)
                        ? absl::StrCat(Percent(average.success.estimate), " ",
                                       IntervalText(average.success.interval))
                        : "-");
    if (method == "base") continue;
    cells.push_back(average.contrasts.versus_base ? DifferenceText(*average.contrasts.versus_base)
                                                  : "-");
    cells.push_back(UpdatesText(average.adapts, average.updates));
  }
  rows.push_back(cells);
  return rows;
}

// The paper's measure per method, intent per method, and the tracking-scaled residual of the first
// method.
std::vector<std::vector<std::string>> ResidualRows(const SuccessTable& table) {
  std::vector<std::vector<std::string>> rows = {{"Residual (%)"}};
  for (const std::string& method : table.methods) rows[0].push_back(method);
  for (const std::string& method : table.methods) rows[0].push_back(method + " intent");
  rows[0].insert(rows[0].end(), {table.methods.front() + " tracking", "paper (pi0)"});
  const auto measures_of = [](const ScenarioRow& row, const std::string& method) {
    const auto cell = row.cells.find(method);
    return cell == row.cells.end() ? Measures() : cell->second.measures;
  };
  for (const ScenarioRow& row : table.rows) {
    std::vector<std::string> cells = {row.title};
    for (const std::string& method : table.methods)
      cells.push_back(OptionalPercent(measures_of(row, method).residual_mean));
    for (const std::string& method : table.methods)
      cells.push_back(OptionalPercent(measures_of(row, method).intent_mean));
    cells.push_back(OptionalPercent(measures_of(row, table.methods.front()).tracking_mean));
    const PaperRow* paper = FindPaperRow(row.scenario);
    cells.push_back(paper == nullptr ? "-" : absl::StrFormat("%.1f", paper->residual));
    rows.push_back(cells);
  }
  return rows;
}

std::string PointsText(const Comparison& c) {
  const Interval& interval = c.difference.interval;
  if (!std::isfinite(interval.low)) return "one cluster: no interval";
  const bool chance = interval.low <= 0 && interval.high >= 0;
  return absl::StrFormat("%+.1f points [%+.1f, %+.1f]%s", PercentagePoints(c.difference.estimate),
                         PercentagePoints(interval.low), PercentagePoints(interval.high),
                         chance ? ", which may be chance" : "");
}

}  // namespace

std::string Conclusion(const SuccessTable& table) {
  const auto base = table.averages.find("base");
  if (base == table.averages.end() || !std::isfinite(base->second.success.estimate)) return "";
  const auto scenarios = std::count_if(table.rows.begin(), table.rows.end(),
                                       [](const auto& row) { return row.scenario != "clean"; });
  std::vector<std::string> others;
  CountRange counts;
  counts.Add(base->second.n);
  for (const std::string& method : table.methods) {
    const auto found = table.averages.find(method);
    if (method == "base" || found == table.averages.end() || !found->second.contrasts.versus_base)
      continue;
    const AverageCell& average = found->second;
    counts.Add(average.n);
    others.push_back(
        absl::StrCat(MethodTitle(method), " ", Percent(average.success.estimate), " % (",
                     PointsText(*average.contrasts.versus_base),
                     average.adapts && average.updates == 0 ? "; it never adapted" : "", ")"));
  }
  if (others.empty()) return "";
  const bool arms = !ArmTitle(table.rows.front().scenario).empty();
  return absl::StrCat(
      "Over ", scenarios, arms ? " arm" : " scenario", scenarios == 1 ? "" : "s",
      arms ? ", " : " with errors, ", counts.Text(), " episodes a method, Base succeeds in ",
      Percent(base->second.success.estimate), " %, ", absl::StrJoin(others, ", "), ".");
}

std::string MissingNote(const SuccessTable& table) {
  std::vector<std::string> methods;
  for (const std::string& method : table.methods) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end() || average->second.missing.empty()) continue;
    methods.push_back(
        absl::StrCat(MethodTitle(method), " lacks ", absl::StrJoin(average->second.missing, ", ")));
  }
  if (methods.empty()) return "";
  return absl::StrCat(
      "An average is over every scenario of the table: ", absl::StrJoin(methods, "; "), ".");
}

std::string TerminalTable(const RunData& run, const Summary& summary) {
  std::string text;
  for (const SuccessTable& table : summary.tables) {
    absl::StrAppend(&text, "\n", TableHeading(table), "\n", AlignedTable(SuccessRows(table)));
    if (const std::string note = MissingNote(table); !note.empty())
      absl::StrAppend(&text, "  ", note, "\n");
    if (table.suite.empty()) absl::StrAppend(&text, "\n", AlignedTable(ResidualRows(table)));
  }
  absl::StrAppend(
      &text,
      "\n  [a, b]: 95 % intervals; Wilson for a success rate, paired bootstrap for a "
      "difference and an average,\n"
      "  over tasks where a method carries something from episode to episode, otherwise "
      "over initial states. +a/-b: episodes that only the method, only base, won.\n"
      "  Residual: ||eta|| / ||a||, mean over rollouts, no gripper; intent: against "
      "the unadapted policy's command; tracking: with\n"
      "  the controller's steady gain in the scale. The paper's column: another policy",
      summary.papers_tasks ? "" : " and other tasks", ".\n");
  std::vector<std::string> notes = ServerNotes(run);
  notes.insert(notes.begin(),
               {UnlikeUnitsNote(run), LiberoFilesNote(run), MixedMachinesNote(run),
                UnpairedNoiseNote(run), LateAnswersNote(run), ClippedCommandsNote(run)});
  for (const std::string& note : notes)
    if (!note.empty()) absl::StrAppend(&text, "  ", note, "\n");
  if (!run.unfinished.empty()) {
    absl::StrAppend(&text, "  ", run.unfinished.size(),
                    " unfinished units are left out; the same sweep command completes them.\n");
  }
  if (summary.tables.empty()) return text;
  if (const std::string came_out = Conclusion(summary.tables.front()); !came_out.empty())
    absl::StrAppend(&text, "\n", came_out, "\n");
  return text;
}

std::string TableMarkdown(const Summary& summary) {
  std::string text;
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    absl::StrAppend(&text, TableHeading(table), "\n\n", MarkdownTable(SuccessRows(table)), "\n");
    if (const std::string note = MissingNote(table); !note.empty())
      absl::StrAppend(&text, note, "\n\n");
  }
  return text;
}

}  // namespace robostress
