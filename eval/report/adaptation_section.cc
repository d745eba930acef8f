#include "eval/report/adaptation_section.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "adapter/methods.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"
#include "eval/report/html_numbers.h"
#include "eval/report/paper_values.h"

namespace robostress {
namespace {

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
      "style=\"text-align:left\">Method</th><th>n</th><th>\u2016\u03b7\u2016 / "
      "\u2016a\u2016<br><small>mean, "
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
                      "</td><td style=\"text-align:left\">", MethodLabel(method), "</td><td>",
                      found->second.n, "</td>", cells_of(found->second.measures),
                      "<td class=paper>",
                      first && paper != nullptr ? absl::StrFormat("%.1f", paper->residual) : "",
                      "</td></tr>\n");
      first = false;
    }
  }
  bool first = true;
  for (const std::string& method : table.methods) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end() || average->second.n == 0) continue;
    absl::StrAppend(&html, first ? "<tr class=avg><td>Average without Clean" : "<tr><td>",
                    "</td><td style=\"text-align:left\">", MethodLabel(method), "</td><td>",
                    average->second.n, "</td>", cells_of(average->second.measures),
                    "<td class=paper>",
                    first ? absl::StrFormat("%.1f", PaperAverage().residual) : "", "</td></tr>\n");
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

// Units at each point: "12", or "8 to 12".
std::string CountText(const std::vector<int>& episodes) {
  CountRange counts;
  for (const int n : episodes) counts.Add(n);
  return counts.Text();
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
                    " <small class=paper>n = ", CountText(curve.episodes), "</small></span>");
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

// Residual and tracking of intent, base beside the method on the same episodes; empty when nothing
// was updated.
std::string BeforeAfterTable(const SuccessTable& table) {
  const auto cells = [](const std::optional<BeforeAfter>& b) {
    if (!b) return std::string("<td>\u2013</td><td>\u2013</td><td>\u2013</td>");
    return absl::StrCat("<td>", Percent(b->before), "</td><td>", Percent(b->after), "</td><td>",
                        Signed(b->change.estimate), "<span class=ci>",
                        IntervalHtml(b->change.interval, true), "</span></td>");
  };
  std::string body;
  const auto add = [&](const std::string& title, const std::string& method, const Contrasts& c,
                       bool average) {
    if (!c.residual && !c.intent) return;
    absl::StrAppend(&body, average ? "<tr class=avg><td>" : "<tr><td>", EscapeXml(title),
                    "</td><td style=\"text-align:left\">", MethodLabel(method), "</td><td>",
                    std::max(c.residual ? c.residual->pairs : 0, c.intent ? c.intent->pairs : 0),
                    "</td>", cells(c.residual), cells(c.intent), "</tr>\n");
  };
  for (const ScenarioRow& row : table.rows) {
    for (const std::string& method : table.methods) {
      const auto found = row.cells.find(method);
      if (found != row.cells.end()) add(row.title, method, found->second.contrasts, false);
    }
  }
  for (const auto& [method, average] : table.averages)
    add("Average without Clean", method, average.contrasts, true);
  if (body.empty()) return "";
  return absl::StrCat(
      "<h4>Before and after adaptation</h4><div class=scroll><table><tr><th>Scenario</th><th "
      "style=\"text-align:left\">Method</th><th>n</th><th>residual before<br><small>%</small></th>"
      "<th>after</th><th>change<br><small>points [95 %]</small></th><th>from intent before"
      "<br><small>%</small></th><th>after</th><th>change<br><small>points [95 %]</small></th>"
      "</tr>\n",
      body, "</table></div>\n");
}

}  // namespace

std::string ResidualSection(const Summary& summary) {
  std::string html = "<h2 id=residual>How far execution is from the command</h2>\n";
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    absl::StrAppend(&html, "<h3>", EscapeXml(table.policy), ", severity L", table.severity, "</h3>",
                    ResidualTableHtml(table), BeforeAfterTable(table));
  }
  return html +
         "<p class=note>\u2016\u03b7\u2016 / \u2016a\u2016 is the paper's measure "
         "(tab:residual-magnitude): achieved minus commanded end-effector motion over the command, "
         "gripper excluded; "
         "mean: over rollouts; pooled: \u221a(\u03a3\u2016\u03b7\u2016\u00b2 / "
         "\u03a3\u2016a\u2016\u00b2). With tracking gain: the displacement is divided by the "
         "controller's steady gain first, so controller lag no longer "
         "counts as error. Of intent: \u2016dx \u2212 a_base\u2016 / \u2016a_base\u2016, against "
         "the "
         "unadapted policy's command on the same observation. The paper's column comes from "
         "\u03c0\u2080 on LIBERO: "
         "the protocol differs, compare the order of scenarios at most. Before and after: base "
         "and the method on the same episodes, those that began after the method's first update; "
         "changes with a paired cluster bootstrap.</p>\n";
}

std::string AdaptationSection(const Summary& summary) {
  std::string html = "<h2 id=adaptation>Adaptation over episodes</h2>\n";
  for (const CurveSet& set : summary.curves) {
    absl::StrAppend(&html, "<h3>", EscapeXml(set.policy), ", severity L", set.severity, "</h3>",
                    CurvePlots(set));
  }
  return html +
         "<p class=note>Means over all units with errors at the same episode of their unit, n at "
         "each point beside the method's name; dashed lines are task boundaries, where the buffer "
         "is cleared and the adapter is carried on.</p>\n";
}

}  // namespace robostress
