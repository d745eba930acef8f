#include "eval/report/statistics_section.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/svg_plot.h"
#include "eval/report/html_numbers.h"
#include "eval/statistics/paired_tests.h"

namespace robostress {
namespace {

constexpr double kPlannedPoints[] = {2, 5, 10};

std::string ComparisonCells(const Comparison* c) {
  if (c == nullptr) return "<td>\u2013</td><td>\u2013</td><td>\u2013</td><td>\u2013</td>";
  return absl::StrCat("<td>", Signed(c->difference.estimate), "<span class=ci>",
                      IntervalHtml(c->difference.interval, true), "</span></td><td>", c->plus,
                      " / ", c->minus, "<span class=ci>of ", c->pairs, "</span></td><td>",
                      EscapeXml(PValueText(c->p_value)), c->p_exact ? "" : "*", "</td><td>",
                      EscapeXml(PValueText(c->p_holm)), "</td>");
}

const Comparison* ControlOf(const Contrasts& contrasts, const std::string& control) {
  const auto found = contrasts.versus_control.find(control);
  return found == contrasts.versus_control.end() ? nullptr : &found->second;
}

std::string ContrastRow(const std::string& title, const std::string& method,
                        const Contrasts& contrasts, bool has_gain, bool has_null, bool average) {
  std::string html =
      absl::StrCat(average ? "<tr class=avg>" : "<tr>", "<td>", EscapeXml(title),
                   "</td><td style=\"text-align:left\">", MethodLabel(method), "</td>");
  const auto& base = contrasts.versus_base;
  absl::StrAppend(&html, "<td>", base ? ClustersText(*base) : "\u2013", "</td>");
  html += ComparisonCells(base ? &*base : nullptr);
  if (has_gain) html += ComparisonCells(ControlOf(contrasts, "gain"));
  if (has_null) html += ComparisonCells(ControlOf(contrasts, "null"));
  return html + "</tr>\n";
}

bool HasControl(const SuccessTable& table, const std::string& control) {
  for (const ScenarioRow& row : table.rows) {
    for (const auto& [method, cell] : row.cells) {
      if (ControlOf(cell.contrasts, control) != nullptr) return true;
    }
  }
  return false;
}

// Every comparison of the table; empty when there is none.
std::string ContrastTable(const SuccessTable& table) {
  const bool has_gain = HasControl(table, "gain"), has_null = HasControl(table, "null");
  std::string body;
  for (const ScenarioRow& row : table.rows) {
    std::string title = row.title;
    for (const std::string& method : table.methods) {
      const auto cell = row.cells.find(method);
      if (cell == row.cells.end() || !cell->second.contrasts.versus_base) continue;
      body += ContrastRow(title, method, cell->second.contrasts, has_gain, has_null, false);
      title.clear();
    }
  }
  std::string title = "Average without Clean";
  for (const std::string& method : table.methods) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end() || !average->second.contrasts.versus_base) continue;
    body +=
        ContrastRow(title, method, average->second.contrasts, has_gain, has_null, !title.empty());
    title.clear();
  }
  if (body.empty()) return "";
  std::string html =
      "<div class=scroll><table><tr><th>Scenario</th><th "
      "style=\"text-align:left\">Method</th><th>clusters</th>";
  const auto columns = [&](const std::string& reference) {
    absl::StrAppend(&html, "<th>\u2212 ", reference,
                    "<br><small>points [95 %]</small></th><th>won / lost</th><th>p</th><th>p, "
                    "Holm</th>");
  };
  columns("base");
  if (has_gain) columns("gain control");
  if (has_null) columns("null control");
  return html + "</tr>\n" + body + "</table></div>\n";
}

std::string SpreadHtml(const SeedSpread& spread, int n) {
  std::vector<std::string> means;
  for (const double mean : spread.means) means.push_back(Percent(mean));
  return absl::StrCat("<td>", Percent(spread.mean), "<span class=ci>n = ", n, "</span></td><td>",
                      std::isfinite(spread.deviation) ? Percent(spread.deviation) : "\u2013",
                      "<span class=ci>", absl::StrJoin(means, ", "), "</span></td>");
}

// Means over seeds; empty with one seed.
std::string SeedTable(const SuccessTable& table) {
  size_t seeds = 0;
  std::string body;
  const auto row = [&](const std::string& title, const auto& cell_of, bool average) {
    absl::StrAppend(&body, average ? "<tr class=avg><td>" : "<tr><td>", EscapeXml(title), "</td>");
    for (const std::string& method : table.methods) {
      const auto* cell = cell_of(method);
      if (cell != nullptr) seeds = std::max(seeds, cell->seeds.seeds.size());
      body += cell == nullptr ? "<td>\u2013</td><td>\u2013</td>" : SpreadHtml(cell->seeds, cell->n);
    }
    body += "</tr>\n";
  };
  for (const ScenarioRow& scenario : table.rows) {
    row(
        scenario.title,
        [&](const std::string& method) -> const Cell* {
          const auto found = scenario.cells.find(method);
          return found == scenario.cells.end() ? nullptr : &found->second;
        },
        false);
  }
  if (!table.averages.empty()) {
    row(
        "Average without Clean",
        [&](const std::string& method) -> const AverageCell* {
          const AverageCell& average = table.averages.at(method);
          return average.n == 0 ? nullptr : &average;
        },
        true);
  }
  if (seeds < 2) return "";
  std::string html =
      absl::StrCat("<h3>Means over ", seeds, table.noise_paired ? " seeds" : " repeats",
                   "</h3><div class=scroll><table><tr><th>Scenario</th>");
  for (const std::string& method : table.methods)
    absl::StrAppend(&html, "<th>", MethodLabel(method), "<br><small>mean, %</small></th><th>",
                    table.noise_paired ? "between seeds" : "between repeats",
                    "<br><small>standard deviation; each</small></th>");
  return html + "</tr>\n" + body + "</table></div>\n";
}

// Episodes needed, from the averages' discordant shares; empty when nothing was paired.
std::string PlanTable(const SuccessTable& table) {
  std::string body;
  for (const std::string& method : table.methods) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end() || !average->second.contrasts.versus_base) continue;
    const Comparison& c = *average->second.contrasts.versus_base;
    absl::StrAppend(&body, "<tr><td>", MethodLabel(method), "</td><td>", c.pairs, "</td><td>",
                    Percent(c.discordant_share()), "</td><td>",
                    absl::StrFormat("%.2f", c.design_effect), "</td>");
    for (const double points : kPlannedPoints) {
      const std::string needed = EpisodesNeededText(c, points);
      absl::StrAppend(&body, "<td>", needed.empty() ? "\u2013" : needed, "</td>");
    }
    body += "</tr>\n";
  }
  if (body.empty()) return "";
  std::string html =
      "<h3>Episodes needed</h3><div class=scroll><table><tr><th>Against base</th><th>pairs "
      "here</th><th>outcomes that differ<br><small>%</small></th><th>design effect</th>";
  for (const double points : kPlannedPoints)
    absl::StrAppend(&html, "<th>for ", points, " points</th>");
  return html + "</tr>\n" + body + "</table></div>\n";
}

}  // namespace

std::string EpisodesNeededText(const Comparison& comparison, double points) {
  const std::optional<double> pairs = PairsNeeded(points / 100, comparison.discordant_share());
  if (!pairs) return "";
  return absl::StrFormat("%.0f", std::ceil(*pairs * std::max(1.0, comparison.design_effect)));
}

std::string StatisticsSection(const Summary& summary) {
  std::string html;
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    const std::string contrasts = ContrastTable(table), seeds = SeedTable(table);
    if (contrasts.empty() && seeds.empty()) continue;
    absl::StrAppend(&html, "<h3>", EscapeXml(table.policy), ", severity L", table.severity, ", ",
                    EscapeXml(table.title), table.noise_paired ? "" : "; sampling noise not paired",
                    "</h3>\n", contrasts, seeds, PlanTable(table));
  }
  if (html.empty()) return "";
  return absl::StrCat(
      "<h2 id=statistics>What the differences are worth</h2>\n", html,
      "<p class=note>Pairs start from the same state ",
      summary.noise_paired
          ? "with the same seed"
          : "and share no sampling noise: the test holds, but more pairs differ by chance; repeats "
            "pair by their number, on which won / lost depend and no difference, interval or p",
      ". p: two-sided, the signs "
      "of all differences of a cluster flipped together; enumerated, or * estimated from ",
      kSignFlipDraws,
      " draws. A cluster is all pairs of one task where the method carries something from episode "
      "to "
      "episode, otherwise of one initial state; scenarios and seeds share them. With one pair in a "
      "cluster it is McNemar's exact test. Holm: corrected over all "
      "comparisons of the same kind in the table's scenarios, the averages among themselves; it "
      "holds however the comparisons depend on each other. Design effect: variance with clusters "
      "kept together over that of single pairs. Episodes needed: two-sided 5 %, power 80 %, with "
      "this share of differing outcomes, times a design effect above 1; not corrected for "
      "number.</p>\n");
}

}  // namespace robostress
