#include "eval/report_page.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "common/html_page.h"
#include "common/svg_plot.h"
#include "eval/paper_values.h"
#include "eval/progress.h"
#include "eval/report_appendix.h"

namespace robostress {
namespace {

std::string Minus(const std::string& text) { return absl::StrReplaceAll(text, {{"-", "\u2212"}}); }
std::string Percent(double fraction) { return absl::StrFormat("%.1f", 100 * fraction); }

// The first names, and how many there are when there are more.
std::string FirstOf(std::vector<std::string> names, size_t count) {
  const size_t all = names.size();
  names.resize(std::min(all, count));
  return absl::StrCat(absl::StrJoin(names, ", "), all > count ? absl::StrCat(" ... ", all) : "");
}
std::string Signed(double fraction) {
  return Minus(absl::StrFormat("%+.1f", PercentagePoints(fraction)));
}
std::string OptionalPercent(const std::optional<double>& value) {
  return value ? Percent(*value) : "\u2013";
}

std::string IntervalText(const Interval& interval, bool with_sign) {
  if (!std::isfinite(interval.low)) return "no interval";
  return Minus(with_sign
                   ? absl::StrFormat("[%+.1f, %+.1f]", PercentagePoints(interval.low),
                                     PercentagePoints(interval.high))
                   : absl::StrFormat("[%.0f, %.0f]", 100 * interval.low, 100 * interval.high));
}

std::string MethodLabel(const std::string& method) {
  return absl::StrCat("<span class=dot style=\"background:", MethodColor(method), "\"></span>",
                      EscapeXml(MethodTitle(method)));
}

// Methods that were paired with base somewhere in the table.
std::vector<std::string> ComparedMethods(const SuccessTable& table) {
  std::vector<std::string> methods;
  for (const std::string& method : table.methods) {
    const bool compared =
        std::any_of(table.rows.begin(), table.rows.end(), [&](const ScenarioRow& row) {
          return row.cells.count(method) && row.cells.at(method).versus_base.has_value();
        });
    if (compared) methods.push_back(method);
  }
  return methods;
}

std::string UpdatesHtml(bool adapts, int updates) {
  const std::string text = UpdatesText(adapts, updates);
  if (text == "not adapted") return "<span class=tag>not adapted</span>";
  return text == "-" ? "\u2013" : text;
}

std::string DifferenceHtml(const std::optional<Comparison>& c) {
  if (!c) return "\u2013";
  return absl::StrFormat("%s<span class=ci>%s</span><span class=ci>+%d / \u2212%d of %d</span>",
                         Signed(c->difference.estimate), IntervalText(c->difference.interval, true),
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
  return absl::StrCat("<td>", Percent(rate), "<span class=ci>", IntervalText(interval, false),
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
    int n = 0;
    for (const auto& [method, cell] : row.cells) n = std::max(n, cell.n);
    absl::StrAppend(&html, "<tr><td>", EscapeXml(row.title), "</td><td>", n, "</td>");
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
    html += "<tr class=avg><td>Average without Clean</td><td></td>";
    for (const std::string& method : table.methods) {
      const AverageCell& average = table.averages.at(method);
      html += RateHtml(average.success.estimate, average.success.interval, average.adapts,
                       average.updates);
    }
    absl::StrAppendFormat(&html,
                          "<td class=paper>%.1f / %.1f</td><td class=paper>%.1f / %.1f</td></tr>\n",
                          kPaperAverage.pi0_base, kPaperAverage.pi0_ours, kPaperAverage.pi05_base,
                          kPaperAverage.pi05_ours);
  }
  return html + "</table></div>\n";
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
          found == row.cells.end() ? "\u2013" : DifferenceHtml(found->second.versus_base), "</td>");
    }
    html += "</tr>\n";
  }
  if (!table.averages.empty()) {
    html += "<tr class=avg><td>Average without Clean</td>";
    for (const std::string& method : methods)
      absl::StrAppend(&html, "<td>", DifferenceHtml(table.averages.at(method).versus_base),
                      "</td>");
    html += "</tr>\n";
  }
  return html + "</table></div>\n";
}

std::string ResidualTableHtml(const SuccessTable& table) {
  const auto cells_of = [](const Measures& m) {
    return absl::StrCat(
        "<td>", OptionalPercent(m.residual_mean), "</td><td>", OptionalPercent(m.residual_pooled),
        "</td><td>", OptionalPercent(m.tracking_mean), "</td><td>", OptionalPercent(m.intent_mean),
        "</td><td>", m.mean_abs_action ? absl::StrFormat("%.3f", *m.mean_abs_action) : "\u2013",
        "</td><td>", OptionalPercent(m.clipped_share), "</td><td>",
        m.adapter_distance ? absl::StrFormat("%.3g", *m.adapter_distance) : "\u2013", "</td>");
  };
  std::string html =
      "<div class=scroll><table><tr><th>Scenario</th><th "
      "style=\"text-align:left\">Method</th><th>\u2016\u03b7\u2016 / \u2016a\u2016<br><small>mean, "
      "%</small></th>"
      "<th>\u2016\u03b7\u2016 / \u2016a\u2016<br><small>pooled, %</small></th><th>with tracking "
      "gain<br><small>mean, %</small></th>"
      "<th>of intent<br><small>mean, "
      "%</small></th><th>|a|<br><small>mean</small></th><th>clipped<br><small>%</small></th>"
      "<th>\u2016\u03c6 \u2212 \u03c6<sub>0</sub>\u2016<br><small>at the end</small></th><th "
      "class=paper>paper, \u03c0<sub>0</sub><br><small>mean, %</small></th></tr>\n";
  for (const ScenarioRow& row : table.rows) {
    bool first = true;
    for (const std::string& method : table.methods) {
      const auto found = row.cells.find(method);
      if (found == row.cells.end()) continue;
      const PaperRow* paper = FindPaperRow(row.scenario);
      absl::StrAppend(&html, "<tr><td>", first ? EscapeXml(row.title) : "",
                      "</td><td style=\"text-align:left\">", MethodLabel(method), "</td>",
                      cells_of(found->second.measures), "<td class=paper>",
                      first && paper != nullptr ? absl::StrFormat("%.1f", paper->residual) : "",
                      "</td></tr>\n");
      first = false;
    }
  }
  bool first = true;
  for (const std::string& method : table.methods) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end()) continue;
    absl::StrAppend(&html, first ? "<tr class=avg><td>Average without Clean" : "<tr><td>",
                    "</td><td style=\"text-align:left\">", MethodLabel(method), "</td>",
                    cells_of(average->second.measures), "<td class=paper>",
                    first ? absl::StrFormat("%.1f", kPaperAverage.residual) : "", "</td></tr>\n");
    first = false;
  }
  return html + "</table></div>\n";
}

// Moving mean over up to `window` past points.
std::vector<double> Smoothed(const std::vector<double>& values, int window) {
  std::vector<double> smooth(values.size());
  for (size_t i = 0; i < values.size(); ++i) {
    double sum = 0;
    int count = 0;
    for (size_t j = i + 1 < static_cast<size_t>(window) ? 0 : i + 1 - window; j <= i; ++j) {
      if (!std::isfinite(values[j])) continue;
      sum += values[j];
      ++count;
    }
    smooth[i] = count == 0 ? std::nan("") : sum / count;
  }
  return smooth;
}

std::string CurvePlots(const CurveSet& set) {
  std::vector<LineSeries> success, residual, action, clipped, distance;
  size_t length = 0;
  for (const AdaptationCurve& curve : set.curves) length = std::max(length, curve.success.size());
  const int window = std::clamp(static_cast<int>(length) / 8, 3, 20);
  std::string legend;
  for (const AdaptationCurve& curve : set.curves) {
    std::vector<double> x;
    for (size_t i = 0; i < curve.success.size(); ++i) x.push_back(static_cast<double>(i + 1));
    const auto percent = [](std::vector<double> values) {
      for (double& value : values) value *= 100;
      return values;
    };
    const std::string color = MethodColor(curve.method);
    success.push_back({curve.method, color, x, percent(Smoothed(curve.success, window))});
    residual.push_back({curve.method, color, x, percent(curve.residual)});
    action.push_back({curve.method, color, x, Smoothed(curve.mean_abs_action, window)});
    clipped.push_back({curve.method, color, x, percent(curve.clipped_share)});
    distance.push_back({curve.method, color, x, curve.adapter_distance});
    absl::StrAppend(&legend, "<span style=\"margin-right:16px\">", MethodLabel(curve.method),
                    " <small class=paper>", curve.units, " units</small></span>");
  }
  LinePlotOptions options;
  options.width = 344;
  options.x_label = "episode of the unit";
  for (size_t mark = set.episodes_per_task; set.episodes_per_task > 0 && mark < length;
       mark += set.episodes_per_task) {
    options.vertical_marks.push_back(mark + 0.5);
  }
  std::string html = absl::StrCat("<p>", legend, "</p><div class=panels>");
  options.title = absl::StrCat("Success, mean of the last ", window, " [%]");
  options.y_min = 0;
  options.y_max = 100;
  html += LinePlot(success, options);
  options.y_max.reset();
  options.title = "Residual \u2016\u03b7\u2016 / \u2016a\u2016 [%]";
  html += LinePlot(residual, options);
  options.title = absl::StrCat("Mean |a|, mean of the last ", window);
  html += LinePlot(action, options);
  options.title = "Commands beyond \u00b11 [%]";
  html += LinePlot(clipped, options);
  options.title = "Adapter \u2016\u03c6 \u2212 \u03c6\u2080\u2016";
  html += LinePlot(distance, options);
  return html + "</div>\n";
}

// Average success over severity levels, when there are several.
std::string SeveritySection(const Summary& summary) {
  std::map<std::string, std::map<std::string, LineSeries>> by_policy;  // policy -> method
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    for (const auto& [method, average] : table.averages) {
      LineSeries& series = by_policy[table.policy]
                               .try_emplace(method, LineSeries{method, MethodColor(method), {}, {}})
                               .first->second;
      series.x.push_back(table.severity);
      series.y.push_back(100 * average.success.estimate);
    }
  }
  std::string html;
  for (const auto& [policy, methods] : by_policy) {
    if (methods.empty() || methods.begin()->second.x.size() < 2) continue;
    std::vector<LineSeries> series;
    std::string legend;
    for (const auto& [method, line] : methods) {
      series.push_back(line);
      absl::StrAppend(&legend, "<span style=\"margin-right:16px\">", MethodLabel(method),
                      "</span>");
    }
    LinePlotOptions options;
    options.title = absl::StrCat(policy, ": average success without Clean [%]");
    options.x_label = "severity level";
    options.width = 560;
    options.height = 300;
    options.y_min = 0;
    options.y_max = 100;
    options.dots = true;
    absl::StrAppend(&html, "<p>", legend, "</p>", LinePlot(series, options));
  }
  return html.empty() ? "" : "<h2 id=severity>Severity</h2>\n" + html;
}

const SuccessTable* MainTable(const Summary& summary) {
  const SuccessTable* best = nullptr;
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    if (best == nullptr || table.methods.size() > best->methods.size() ||
        (table.methods.size() == best->methods.size() && table.severity > best->severity))
      best = &table;
  }
  return best;
}

// What the main table says, in words that claim no more than it shows.
std::string Headline(const SuccessTable& table) {
  const auto base = table.averages.find("base");
  if (base == table.averages.end() || !std::isfinite(base->second.success.estimate)) {
    return "<p class=lead>This run has no scenario with errors for the base policy, so there is "
           "nothing to compare yet.</p>";
  }
  std::string text = "<p class=lead>";
  const Cell* clean = nullptr;
  for (const ScenarioRow& row : table.rows) {
    if (row.scenario == "clean" && row.cells.count("base")) clean = &row.cells.at("base");
  }
  if (clean != nullptr) {
    absl::StrAppend(&text, "The unadapted policy succeeds in ", Percent(clean->rate()),
                    " % of the episodes without execution errors and in ");
  } else {
    text += "The unadapted policy succeeds in ";
  }
  absl::StrAppend(&text, Percent(base->second.success.estimate), " % on average under them. ");
  for (const std::string method : {"ours", "ours_intent", "ours_nominal"}) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end() || !average->second.versus_base) continue;
    const Comparison& c = *average->second.versus_base;
    const Interval& interval = c.difference.interval;
    absl::StrAppend(
        &text, "<b>", MethodTitle(method), "</b> (",
        average->second.updates == 0 ? "not adapted"
                                     : absl::StrCat(average->second.updates, " updates"),
        ") reaches ", Percent(average->second.success.estimate),
        " %: ", Signed(c.difference.estimate), " points ", IntervalText(interval, true), ". ");
    if (!std::isfinite(interval.low)) {
      text += "One cluster supports no interval. ";
    } else if (interval.low <= 0 && interval.high >= 0) {
      text += "The interval includes zero: this run does not show a difference. ";
    } else {
      absl::StrAppend(&text, "The interval excludes zero: a ",
                      c.difference.estimate > 0 ? "gain" : "loss", " on these episodes. ");
    }
  }
  text += "</p>\n";
  if (clean != nullptr && clean->rate() < 0.7) {
    absl::StrAppend(&text, "<p class=warn>Success without errors is ", Percent(clean->rate()),
                    " %, under 70 %: a policy this weak supports no claim about adaptation.</p>\n");
  }
  return text;
}

std::string Tile(const std::string& value, const std::string& label) {
  return absl::StrCat("<div class=tile><b>", value, "</b><span>", label, "</span></div>");
}

std::string Tiles(const RunData& run, const Summary& summary, const SuccessTable& table) {
  std::string html = "<div class=tiles>";
  for (const ScenarioRow& row : table.rows) {
    if (row.scenario == "clean" && row.cells.count("base"))
      html += Tile(Percent(row.cells.at("base").rate()) + " %", "base, Clean");
  }
  for (const std::string& method : table.methods) {
    if (html.size() > 700 || !table.averages.count(method)) break;
    html += Tile(Percent(table.averages.at(method).success.estimate) + " %",
                 absl::StrCat(MethodTitle(method), ", average under errors"));
  }
  const auto ours = table.averages.find("ours");
  if (ours != table.averages.end() && ours->second.versus_base) {
    html += Tile(Signed(ours->second.versus_base->difference.estimate),
                 absl::StrCat("points, ours against base<br>",
                              IntervalText(ours->second.versus_base->difference.interval, true)));
    html += Tile(UpdatesHtml(ours->second.adapts, ours->second.updates), "updates applied, ours");
  }
  html += Tile(absl::StrCat(summary.episodes),
               absl::StrCat("episodes in ", run.units.size(), " units"));
  if (run.sweep_wall_s > 0)
    html += Tile(FormatDuration(run.sweep_wall_s), "wall time of the sweep");
  return html + "</div>\n";
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
    categories.push_back(row.title);
    for (size_t m = 0; m < methods.size(); ++m) {
      const auto cell = row.cells.find(methods[m]);
      std::optional<IntervalPoint> point;
      if (cell != row.cells.end() && !difference) {
        point = {100 * cell->second.rate(),
                 {100 * cell->second.wilson.low, 100 * cell->second.wilson.high}};
      } else if (cell != row.cells.end() && cell->second.versus_base) {
        const BootstrapResult& d = cell->second.versus_base->difference;
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
    categories.push_back("Average without Clean");
    for (size_t m = 0; m < methods.size(); ++m) {
      const AverageCell& average = table.averages.at(methods[m]);
      const BootstrapResult* result =
          difference ? average.versus_base ? &average.versus_base->difference : nullptr
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
  std::string html = absl::StrCat("<h3>", EscapeXml(table.policy), ", severity L", table.severity,
                                  ", ", EscapeXml(table.title), "</h3>\n", SuccessTableHtml(table));
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

std::string ReportPage(const RunData& run, const Summary& summary, const ReportOptions& options) {
  const SuccessTable& main = *MainTable(summary);
  const std::string videos = VideoSection(run, options);
  std::string html = PageHead("RoboStress report");
  absl::StrAppend(&html, "<header><div class=wrap><h1>RoboStress: policy ", EscapeXml(main.policy),
                  " under joint-level execution errors</h1><p>Suite",
                  main.title.find(',') == std::string::npos ? " " : "s ", EscapeXml(main.title),
                  " \u00b7 severity L", main.severity, " \u00b7 ", summary.episodes,
                  " episodes \u00b7 ", run.units.size(), " units</p></div></header>\n");
  absl::StrAppend(&html,
                  "<nav><div class=wrap><a href=\"#success\">Success</a><a "
                  "href=\"#residual\">Residuals</a><a href=\"#adaptation\">Adaptation</a>",
                  videos.empty() ? "" : "<a href=\"#videos\">Rollouts</a>",
                  options.training.empty() ? "" : "<a href=\"#training\">Training</a>",
                  "<a href=\"#setup\">Setup</a><a href=\"#limits\">Limits</a></div></nav>\n<main "
                  "class=wrap>\n");
  absl::StrAppend(&html, Headline(main), Tiles(run, summary, main));
  if (const std::string note = MixedMachinesNote(run); !note.empty())
    absl::StrAppend(&html, "<p class=warn>", EscapeXml(note), ".</p>\n");
  if (!run.unfinished.empty()) {
    absl::StrAppend(&html, "<p class=warn>", run.unfinished.size(),
                    " unfinished units are left out of every number on this page: ",
                    EscapeXml(FirstOf(run.unfinished, 50)), ".</p>\n");
  }
  html += "<h2 id=success>Success</h2>\n";
  for (const SuccessTable& table : summary.tables) html += TableSection(table);
  absl::StrAppend(
      &html,
      "<p class=note>Intervals of a success rate are Wilson's, of a difference and of an average a "
      "paired cluster bootstrap over (task, initial state) with ",
      summary.replicates,
      " replicates. Won / lost: episodes that only the method, only base, completed; both start "
      "from the same state with the same sampling noise "
      "(the null control has other noise). The paper's columns (tab:realistic) are for orientation "
      "only: another policy, other tasks, 20 episodes on each of 40 tasks, three seeds.</p>\n");
  html += SeveritySection(summary);
  html += "<h2 id=residual>How far execution is from the command</h2>\n";
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    absl::StrAppend(&html, "<h3>", EscapeXml(table.policy), ", severity L", table.severity, "</h3>",
                    ResidualTableHtml(table));
  }
  html +=
      "<p class=note>\u2016\u03b7\u2016 / \u2016a\u2016 is the paper's measure "
      "(tab:residual-magnitude): achieved minus commanded end-effector motion over the command, "
      "gripper excluded; "
      "mean: over rollouts; pooled: \u221a(\u03a3\u2016\u03b7\u2016\u00b2 / "
      "\u03a3\u2016a\u2016\u00b2). With tracking gain: the displacement is divided by the "
      "controller's steady gain first, so controller lag no longer "
      "counts as error. Of intent: \u2016dx \u2212 a_base\u2016 / \u2016a_base\u2016, against the "
      "unadapted policy's command on the same observation. The paper's column comes from "
      "\u03c0\u2080 on LIBERO: "
      "the protocol differs, compare the order of scenarios at most.</p>\n";
  html += "<h2 id=adaptation>Adaptation over episodes</h2>\n";
  for (const CurveSet& set : summary.curves) {
    absl::StrAppend(&html, "<h3>", EscapeXml(set.policy), ", severity L", set.severity, "</h3>",
                    CurvePlots(set));
  }
  html +=
      "<p class=note>Means over all units with errors at the same episode of their unit; dashed "
      "lines are task boundaries, where the buffer is cleared and the adapter is carried on.</p>\n";
  absl::StrAppend(&html, videos, options.training.empty() ? "" : TrainingSection(options.training),
                  SetupSection(run), LimitsSection(run, summary, main));
  absl::StrAppend(&html, "</main><footer><div class=wrap>Written by <code>robostress report ",
                  EscapeXml(run.dir),
                  "</code> from the recorded episodes. "
                  "The same numbers as data: table.csv, report.json, "
                  "episodes.csv.</div></footer></body></html>\n");
  return html;
}

}  // namespace robostress
