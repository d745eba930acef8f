#include "eval/report/report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "eval/plan/titles.h"
#include "eval/report/paper_values.h"
#include "eval/report/report_page.h"
#include "eval/report/severity_section.h"
#include "eval/report/success_section.h"
#include "eval/report/text_table.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

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
                      table.title);
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
    int n = 0;
    for (const auto& [method, cell] : row.cells) n = std::max(n, cell.n);
    std::vector<std::string> cells = {row.title, absl::StrCat(n)};
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
  std::vector<std::string> cells = {"Average without Clean", ""};
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

json NumberOrNull(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? json(*value) : json(nullptr);
}
json IntervalJson(const Interval& interval) {
  return {NumberOrNull(interval.low), NumberOrNull(interval.high)};
}

json ComparisonJson(const std::optional<Comparison>& c) {
  if (!c) return nullptr;
  return {{"difference", NumberOrNull(c->difference.estimate)},
          {"interval", IntervalJson(c->difference.interval)},
          {"clusters", c->difference.clusters},
          {"pairs", c->pairs},
          {"plus", c->plus},
          {"minus", c->minus},
          {"p_value", c->p_value},
          {"p_enumerated", c->p_exact},
          {"p_holm", NumberOrNull(c->p_holm)},
          {"mcnemar_p", c->mcnemar_p},
          {"design_effect", c->design_effect}};
}

json BeforeAfterJson(const std::optional<BeforeAfter>& b) {
  if (!b) return nullptr;
  return {{"pairs", b->pairs},
          {"before", b->before},
          {"after", b->after},
          {"change", NumberOrNull(b->change.estimate)},
          {"interval", IntervalJson(b->change.interval)}};
}

json SeedsJson(const SeedSpread& spread) {
  return {{"seeds", spread.seeds},
          {"means", spread.means},
          {"mean", NumberOrNull(spread.mean)},
          {"standard_deviation", NumberOrNull(spread.deviation)}};
}

// Beside versus_base, which stands first.
void AddContrasts(const Contrasts& contrasts, json& cell) {
  cell["versus_base"] = ComparisonJson(contrasts.versus_base);
  for (const auto& [control, comparison] : contrasts.versus_control)
    cell["versus_" + control] = ComparisonJson(comparison);
  if (contrasts.residual) cell["residual_before_after"] = BeforeAfterJson(contrasts.residual);
  if (contrasts.intent) cell["intent_before_after"] = BeforeAfterJson(contrasts.intent);
}

json MeasuresJson(const Measures& m) {
  return {{"residual_mean", NumberOrNull(m.residual_mean)},
          {"residual_pooled", NumberOrNull(m.residual_pooled)},
          {"residual_tracking_mean", NumberOrNull(m.tracking_mean)},
          {"intent_mean", NumberOrNull(m.intent_mean)},
          {"intent_pooled", NumberOrNull(m.intent_pooled)},
          {"mean_abs_action", NumberOrNull(m.mean_abs_action)},
          {"clipped_share", NumberOrNull(m.clipped_share)},
          {"adapter_distance", NumberOrNull(m.adapter_distance)}};
}

json TableJson(const SuccessTable& table) {
  json rows = json::array();
  for (const ScenarioRow& row : table.rows) {
    json cells = json::object();
    for (const auto& [method, cell] : row.cells) {
      cells[method] = {{"n", cell.n},
                       {"successes", cell.successes},
                       {"rate", cell.rate()},
                       {"wilson", IntervalJson(cell.wilson)},
                       {"units", cell.units},
                       {"adapts", cell.adapts},
                       {"updates", cell.updates},
                       {"seeds", SeedsJson(cell.seeds)},
                       {"measures", MeasuresJson(cell.measures)}};
      AddContrasts(cell.contrasts, cells[method]);
    }
    rows.push_back({{"scenario", row.scenario}, {"cells", cells}});
  }
  json averages = json::object();
  for (const auto& [method, average] : table.averages) {
    averages[method] = {{"success", NumberOrNull(average.success.estimate)},
                        {"interval", IntervalJson(average.success.interval)},
                        {"clusters", average.success.clusters},
                        {"adapts", average.adapts},
                        {"updates", average.updates},
                        {"n", average.n},
                        {"seeds", SeedsJson(average.seeds)},
                        {"measures", MeasuresJson(average.measures)}};
    AddContrasts(average.contrasts, averages[method]);
  }
  return {{"policy", table.policy},
          {"severity", table.severity},
          {"suite", table.suite},
          {"suites", table.title},
          {"methods", table.methods},
          {"scenarios", rows},
          {"average_without_clean", averages}};
}

std::string CsvNumber(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? absl::StrFormat("%.6g", *value) : "";
}

std::vector<std::string> ComparisonCells(const std::optional<Comparison>& c) {
  if (!c) return {"", "", "", "", "", "", ""};
  return {CsvNumber(c->difference.estimate),
          CsvNumber(c->difference.interval.low),
          CsvNumber(c->difference.interval.high),
          absl::StrCat(c->plus),
          absl::StrCat(c->minus),
          absl::StrCat(c->pairs),
          absl::StrCat(c->difference.clusters)};
}

std::vector<std::string> MeasureCells(const Measures& m) {
  return {CsvNumber(m.residual_mean), CsvNumber(m.residual_pooled), CsvNumber(m.tracking_mean),
          CsvNumber(m.intent_mean),   CsvNumber(m.intent_pooled),   CsvNumber(m.mean_abs_action),
          CsvNumber(m.clipped_share), CsvNumber(m.adapter_distance)};
}

// p values, the controls, seeds and before / after, which stand behind the older columns.
std::vector<std::string> ContrastCells(const Contrasts& contrasts, const SeedSpread& seeds) {
  std::vector<std::string> cells = {"", "", ""};
  if (const auto& base = contrasts.versus_base)
    cells = {CsvNumber(base->p_value), CsvNumber(base->p_holm), CsvNumber(base->mcnemar_p)};
  for (const std::string control : {"gain", "null"}) {
    const auto found = contrasts.versus_control.find(control);
    if (found == contrasts.versus_control.end()) {
      cells.insert(cells.end(), {"", "", "", ""});
      continue;
    }
    const Comparison& c = found->second;
    for (const double value :
         {c.difference.estimate, c.difference.interval.low, c.difference.interval.high, c.p_holm})
      cells.push_back(CsvNumber(value));
  }
  for (const auto& change : {contrasts.residual, contrasts.intent}) {
    cells.push_back(change ? CsvNumber(change->before) : "");
    cells.push_back(change ? CsvNumber(change->after) : "");
  }
  cells.push_back(absl::StrCat(seeds.seeds.size()));
  cells.push_back(CsvNumber(seeds.deviation));
  return cells;
}

void AppendCells(std::string& csv, std::vector<std::string> cells, const Contrasts& contrasts,
                 const Measures& measures, const SeedSpread& seeds) {
  for (const std::vector<std::string>& more :
       {ComparisonCells(contrasts.versus_base), MeasureCells(measures),
        ContrastCells(contrasts, seeds)})
    cells.insert(cells.end(), more.begin(), more.end());
  absl::StrAppend(&csv, absl::StrJoin(cells, ","), "\n");
}

}  // namespace

std::string TerminalTable(const RunData& run, const Summary& summary) {
  std::string text;
  for (const SuccessTable& table : summary.tables) {
    absl::StrAppend(&text, "\n", TableHeading(table), "\n", AlignedTable(SuccessRows(table)));
    if (table.suite.empty()) absl::StrAppend(&text, "\n", AlignedTable(ResidualRows(table)));
  }
  absl::StrAppend(&text,
                  "\n  [a, b]: 95 % intervals; Wilson for a success rate, paired bootstrap over "
                  "(task, initial state) for a difference\n"
                  "  and an average. +a/-b: episodes that only the method, only base, won.\n"
                  "  Residual: ||eta|| / ||a||, mean over rollouts, no gripper; intent: against "
                  "the unadapted policy's command; tracking: with\n"
                  "  the controller's steady gain in the scale. The paper's column: another policy "
                  "and other tasks.\n");
  if (const std::string note = MixedMachinesNote(run); !note.empty())
    absl::StrAppend(&text, "  ", note, "\n");
  if (!run.unfinished.empty()) {
    absl::StrAppend(&text, "  ", run.unfinished.size(),
                    " unfinished units are left out; the same sweep command completes them.\n");
  }
  return text;
}

std::string TableMarkdown(const Summary& summary) {
  std::string text;
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    absl::StrAppend(&text, TableHeading(table), "\n\n", MarkdownTable(SuccessRows(table)), "\n");
  }
  return text;
}

std::string TableCsv(const Summary& summary) {
  std::string csv =
      "policy,severity,suite,scenario,method,n,successes,rate,low,high,adapts,updates,difference,"
      "difference_low,difference_high,plus,minus,"
      "pairs,clusters,residual_mean,residual_pooled,residual_tracking_mean,intent_mean,intent_"
      "pooled,mean_abs_action,clipped_share,"
      "adapter_distance,p_value,p_holm,mcnemar_p,versus_gain,versus_gain_low,versus_gain_high,"
      "versus_gain_p_holm,versus_null,versus_null_low,versus_null_high,versus_null_p_holm,"
      "residual_before,residual_after,intent_before,intent_after,seeds,seed_deviation\n";
  for (const SuccessTable& table : summary.tables) {
    const std::string suite = table.suite.empty() ? "all" : table.suite;
    const auto lead = [&](const std::string& scenario, const std::string& method) {
      return std::vector<std::string>{table.policy, absl::StrCat(table.severity), suite, scenario,
                                      method};
    };
    for (const ScenarioRow& row : table.rows) {
      for (const std::string& method : table.methods) {
        const auto found = row.cells.find(method);
        if (found == row.cells.end()) continue;
        const Cell& cell = found->second;
        std::vector<std::string> cells = lead(row.scenario, method);
        for (const std::string& value :
             {absl::StrCat(cell.n), absl::StrCat(cell.successes), CsvNumber(cell.rate()),
              CsvNumber(cell.wilson.low), CsvNumber(cell.wilson.high),
              absl::StrCat(cell.adapts ? 1 : 0), absl::StrCat(cell.updates)}) {
          cells.push_back(value);
        }
        AppendCells(csv, cells, cell.contrasts, cell.measures, cell.seeds);
      }
    }
    for (const std::string& method : table.methods) {
      const auto found = table.averages.find(method);
      if (found == table.averages.end()) continue;
      const AverageCell& average = found->second;
      std::vector<std::string> cells = lead("average_without_clean", method);
      for (const std::string& value :
           {std::string(), std::string(), CsvNumber(average.success.estimate),
            CsvNumber(average.success.interval.low), CsvNumber(average.success.interval.high),
            absl::StrCat(average.adapts ? 1 : 0), absl::StrCat(average.updates)}) {
        cells.push_back(value);
      }
      AppendCells(csv, cells, average.contrasts, average.measures, average.seeds);
    }
  }
  return csv;
}

std::string ReportJson(const RunData& run, const Summary& summary) {
  json tables = json::array();
  for (const SuccessTable& table : summary.tables) tables.push_back(TableJson(table));
  const json report = {{"episodes", summary.episodes},
                       {"bootstrap_replicates", summary.replicates},
                       {"tables", tables},
                       {"unfinished_units", run.unfinished},
                       {"processors", run.machines},
                       {"environment", run.environment},
                       {"sweep_wall_s", run.sweep_wall_s}};
  return report.dump(1) + "\n";
}

absl::Status WriteTables(const RunData& run) {
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/episodes.csv", EpisodeTableCsv(run)));
  return WriteFileAtomically(run.dir + "/timings.csv", UnitTimingCsv(run));
}

absl::Status WriteReport(const RunData& run, const ReportOptions& options) {
  const Summary summary = Summarise(run, options.bootstrap_replicates);
  RS_RETURN_IF_ERROR(MakeDirectories(run.dir + "/figures"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/table.csv", TableCsv(summary)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/table.md", TableMarkdown(summary)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/report.json", ReportJson(run, summary)));
  for (const SuccessTable& table : summary.tables) {
    const std::string name = absl::StrCat(table.policy, "-L", table.severity,
                                          table.suite.empty() ? "" : "-" + table.suite);
    RS_RETURN_IF_ERROR(WriteFileAtomically(absl::StrCat(run.dir, "/figures/success-", name, ".svg"),
                                           SuccessPlot(table)));
  }
  for (const std::string& policy : PoliciesWithLevels(summary)) {
    RS_RETURN_IF_ERROR(
        WriteFileAtomically(absl::StrCat(run.dir, "/figures/severity-", policy, ".svg"),
                            SeverityFigure(summary, policy)));
  }
  RS_RETURN_IF_ERROR(
      WriteFileAtomically(run.dir + "/report.html", ReportPage(run, summary, options)));
  if (options.print) {
    std::printf("%s\nreport: %s/report.html\ntables: %s/table.csv %s/report.json %s/episodes.csv\n",
                TerminalTable(run, summary).c_str(), run.dir.c_str(), run.dir.c_str(),
                run.dir.c_str(), run.dir.c_str());
    if (run.sweep_wall_s > 0)
      std::printf("wall time of the sweep: %s\n", FormatDuration(run.sweep_wall_s).c_str());
  }
  return absl::OkStatus();
}

}  // namespace robostress
