#include "eval/report/success_section.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "adapter/methods.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"
#include "eval/report/html_numbers.h"
#include "eval/report/paper_values.h"
#include "eval/report/report.h"

namespace robostress {
namespace {

// Methods that were paired with base somewhere in the table.
std::vector<std::string> ComparedMethods(const SuccessTable& table) {
  std::vector<std::string> methods;
  for (const std::string& method : table.methods) {
    const bool compared =
        std::any_of(table.rows.begin(), table.rows.end(), [&](const ScenarioRow& row) {
          return row.cells.count(method) && row.cells.at(method).contrasts.versus_base.has_value();
        });
    if (compared) methods.push_back(method);
  }
  return methods;
}

std::string DifferenceHtml(const std::optional<Comparison>& c) {
  if (!c) return "\u2013";
  return absl::StrFormat("%s<span class=ci>%s</span><span class=ci>+%d / \u2212%d of %d</span>",
                         Signed(c->difference.estimate), IntervalHtml(c->difference.interval, true),
                         c->plus, c->minus, c->pairs);
}

std::string RateHtml(double rate, const Interval& interval, bool adapts, int updates) {
  if (!std::isfinite(rate)) return "<td>\u2013</td>";
  const std::string text = UpdatesText(adapts, updates);
  const std::string note =
      !adapts ? ""
      : updates == 0
          ? "<span class=tag>not adapted</span>"
          : absl::StrCat("<span class=ci>", text, updates == 1 ? " update" : " updates", "</span>");
  return absl::StrCat("<td>", Percent(rate), "<span class=ci>", IntervalHtml(interval, false),
                      "</span>", note, "</td>");
}

// Scenarios x methods, as the paper's table.
std::string SuccessTableHtml(const SuccessTable& table) {
  std::string html = "<div class=scroll><table><tr><th>Scenario</th><th>n</th>";
  for (const std::string& method : table.methods)
    absl::StrAppend(&html, "<th>", MethodLabel(method), "<br><small>% [95 %]</small></th>");
  html +=
      "<th class=paper>paper, \u03c0<sub>0</sub><br><small>base / ours</small></th><th "
      "class=paper>paper, \u03c0<sub>0.5</sub><br><small>base / ours</small></th></tr>\n";
  for (const ScenarioRow& row : table.rows) {
    CountRange counts;
    for (const auto& [method, cell] : row.cells) counts.Add(cell.n);
    absl::StrAppend(&html, "<tr><td>", EscapeXml(row.title), "</td><td>", counts.Text(), "</td>");
    for (const std::string& method : table.methods) {
      const auto found = row.cells.find(method);
      html += found == row.cells.end() ? "<td>\u2013</td>"
                                       : RateHtml(found->second.rate(), found->second.wilson,
                                                  found->second.adapts, found->second.updates);
    }
    const PaperRow* paper = FindPaperRow(row.scenario);
    if (paper == nullptr) {
      html += "<td class=paper>\u2013</td><td class=paper>\u2013</td></tr>\n";
    } else {
      absl::StrAppendFormat(
          &html, "<td class=paper>%.1f / %.1f</td><td class=paper>%.1f / %.1f</td></tr>\n",
          paper->pi0_base, paper->pi0_ours, paper->pi05_base, paper->pi05_ours);
    }
  }
  if (!table.averages.empty()) {
    CountRange counts;
    for (const auto& [method, average] : table.averages) counts.Add(average.n);
    absl::StrAppend(&html, "<tr class=avg><td>Average without Clean</td><td>", counts.Text(),
                    "</td>");
    for (const std::string& method : table.methods) {
      const AverageCell& average = table.averages.at(method);
      html += RateHtml(average.success.estimate, average.success.interval, average.adapts,
                       average.updates);
    }
    absl::StrAppendFormat(&html,
                          "<td class=paper>%.1f / %.1f</td><td class=paper>%.1f / %.1f</td></tr>\n",
                          PaperAverage().pi0_base, PaperAverage().pi0_ours,
                          PaperAverage().pi05_base, PaperAverage().pi05_ours);
  }
  html += "</table></div>\n";
  if (const std::string note = MissingNote(table); !note.empty())
    absl::StrAppend(&html, "<p class=note>", EscapeXml(note), "</p>\n");
  return html;
}

// Scenarios x methods against base; empty when nothing was paired.
std::string DifferenceTableHtml(const SuccessTable& table) {
  const std::vector<std::string> methods = ComparedMethods(table);
  if (methods.empty()) return "";
  std::string html = "<div class=scroll><table><tr><th>Against base</th>";
  for (const std::string& method : methods)
    absl::StrAppend(&html, "<th>", MethodLabel(method),
                    "<br><small>points [95 %], won / lost</small></th>");
  html += "</tr>\n";
  for (const ScenarioRow& row : table.rows) {
    absl::StrAppend(&html, "<tr><td>", EscapeXml(row.title), "</td>");
    for (const std::string& method : methods) {
      const auto found = row.cells.find(method);
      absl::StrAppend(
          &html, "<td>",
          found == row.cells.end() ? "\u2013" : DifferenceHtml(found->second.contrasts.versus_base),
          "</td>");
    }
    html += "</tr>\n";
  }
  if (!table.averages.empty()) {
    html += "<tr class=avg><td>Average without Clean</td>";
    for (const std::string& method : methods)
      absl::StrAppend(&html, "<td>",
                      DifferenceHtml(table.averages.at(method).contrasts.versus_base), "</td>");
    html += "</tr>\n";
  }
  return html + "</table></div>\n";
}

std::string PlotRows(const SuccessTable& table, const std::vector<std::string>& methods,
                     bool difference) {
  std::vector<std::string> categories;
  std::vector<IntervalSeries> series;
  for (const std::string& method : methods)
    series.push_back(
        {MethodTitle(method) + (difference ? " against base" : ""), MethodColor(method), {}});
  double extent = 0.1;
  for (const ScenarioRow& row : table.rows) {
    CountRange counts;
    for (const auto& [method, cell] : row.cells) {
      const auto& base = cell.contrasts.versus_base;
      counts.Add(!difference ? cell.n : base ? base->pairs : 0);
    }
    categories.push_back(absl::StrCat(row.title, " (n = ", counts.Text(), ")"));
    for (size_t m = 0; m < methods.size(); ++m) {
      const auto cell = row.cells.find(methods[m]);
      std::optional<IntervalPoint> point;
      if (cell != row.cells.end() && !difference) {
        point = {100 * cell->second.rate(),
                 {100 * cell->second.wilson.low, 100 * cell->second.wilson.high}};
      } else if (cell != row.cells.end() && cell->second.contrasts.versus_base) {
        const BootstrapResult& d = cell->second.contrasts.versus_base->difference;
        point = {100 * d.estimate, {100 * d.interval.low, 100 * d.interval.high}};
        for (const double end : {d.estimate, d.interval.low, d.interval.high})
          extent = std::isfinite(end) ? std::max(extent, std::abs(end)) : extent;
      }
      series[m].points.push_back(point);
    }
  }
  IntervalPlotOptions options;
  if (!table.averages.empty() && table.rows.size() > 1) {
    options.separator_after = static_cast<int>(categories.size()) - 1;
    CountRange counts;
    for (const auto& [method, average] : table.averages) {
      const auto& base = average.contrasts.versus_base;
      counts.Add(!difference ? average.n : base ? base->pairs : 0);
    }
    categories.push_back(absl::StrCat("Average without Clean (n = ", counts.Text(), ")"));
    for (size_t m = 0; m < methods.size(); ++m) {
      const AverageCell& average = table.averages.at(methods[m]);
      const BootstrapResult* result =
          difference
              ? average.contrasts.versus_base ? &average.contrasts.versus_base->difference : nullptr
              : &average.success;
      std::optional<IntervalPoint> point;
      if (result != nullptr && std::isfinite(result->estimate))
        point = {100 * result->estimate, {100 * result->interval.low, 100 * result->interval.high}};
      series[m].points.push_back(point);
    }
  }
  if (difference) {
    options.x_max = 10 * std::ceil(10 * extent);
    options.x_min = -options.x_max;
    options.zero_line = true;
    options.x_label =
        "difference of success against base [percentage points], 95 % bootstrap intervals";
  } else {
    options.x_label = "success [%], 95 % intervals";
  }
  return IntervalPlot(categories, series, options);
}

std::string TableSection(const SuccessTable& table) {
  std::string html = absl::StrCat(
      "<h3>", EscapeXml(table.policy), ", severity L", table.severity, ", ", EscapeXml(table.title),
      table.noise_paired ? "" : "; sampling noise not paired", "</h3>\n", SuccessTableHtml(table));
  if (table.suite.empty()) html += SuccessPlot(table);
  html += DifferenceTableHtml(table);
  if (table.suite.empty()) html += DifferencePlot(table);
  return html;
}

}  // namespace

std::string SuccessPlot(const SuccessTable& table) { return PlotRows(table, table.methods, false); }

std::string DifferencePlot(const SuccessTable& table) {
  const std::vector<std::string> methods = ComparedMethods(table);
  return methods.empty() ? "" : PlotRows(table, methods, true);
}

std::string SuccessSection(const Summary& summary) {
  std::string html = "<h2 id=success>Success</h2>\n";
  for (const SuccessTable& table : summary.tables) html += TableSection(table);
  absl::StrAppend(
      &html, "<p class=note>Intervals of a success rate are Wilson's",
      summary.noise_paired ? "" : ", with n divided by the design effect of repeated states",
      ", of a difference and of an average a "
      "paired cluster bootstrap (over tasks where a method carries something from episode to "
      "episode, otherwise over initial states) with ",
      summary.replicates,
      " replicates. Won / lost: episodes that only the method, only base, completed; both start "
      "from the same state",
      summary.noise_paired ? " with the same sampling noise (the null control has other noise)"
                           : ", with sampling noise of their own",
      ". The paper's columns (tab:realistic) are for orientation only: another policy, ",
      summary.papers_tasks ? "" : "other tasks, ",
      "20 episodes on each of 40 tasks, three seeds.</p>\n");
  return html;
}

}  // namespace robostress
