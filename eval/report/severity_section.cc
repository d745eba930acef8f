#include "eval/report/severity_section.h"

#include <algorithm>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "adapter/methods.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"
#include "eval/report/html_numbers.h"

namespace robostress {
namespace {

constexpr int kPanelWidth = 304, kPanelHeight = 176;

// A scenario in a suite: success by method and level.
struct Panel {
  std::string title;  // of the scenario
  std::map<std::string, std::map<int, const Cell*>> cells;
};

// Rows and columns in the order of the tables.
struct PanelGrid {
  std::vector<std::string> scenarios, suites, methods;  // suites: titles
  std::map<std::pair<std::string, std::string>, Panel> panels;
};

void AddOnce(std::vector<std::string>& names, const std::string& name) {
  if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
}

PanelGrid CollectPanels(const Summary& summary, const std::string& policy) {
  // With several suites each has tables of its own; with one the common table is the suite's.
  const bool several = std::any_of(
      summary.tables.begin(), summary.tables.end(),
      [&](const SuccessTable& table) { return table.policy == policy && !table.suite.empty(); });
  PanelGrid grid;
  for (const SuccessTable& table : summary.tables) {
    if (table.policy != policy || table.suite.empty() == several) continue;
    AddOnce(grid.suites, table.title);
    for (const std::string& method : table.methods) AddOnce(grid.methods, method);
    for (const ScenarioRow& row : table.rows) {
      if (!row.has_levels) continue;
      AddOnce(grid.scenarios, row.scenario);
      Panel& panel = grid.panels[{row.scenario, table.title}];
      panel.title = row.title;
      for (const auto& [method, cell] : row.cells) panel.cells[method][table.severity] = &cell;
    }
  }
  return grid;
}

std::string CountText(const Panel& panel) {
  CountRange counts;
  for (const auto& [method, levels] : panel.cells) {
    for (const auto& [level, cell] : levels) counts.Add(cell->n);
  }
  return counts.Text();
}

LinePlotOptions LevelAxis() {
  LinePlotOptions options;
  options.x_label = "severity level";
  options.y_min = 0;
  options.y_max = 100;
  options.dots = true;
  return options;
}

std::string PanelPlot(const Panel& panel, const std::vector<std::string>& methods,
                      const std::string& suite) {
  std::vector<LineSeries> series;
  for (const std::string& method : methods) {
    const auto levels = panel.cells.find(method);
    if (levels == panel.cells.end()) continue;
    LineSeries line{method, MethodColor(method), {}, {}, {}, {}, ""};
    for (const auto& [level, cell] : levels->second) {
      line.x.push_back(level);
      line.y.push_back(100 * cell->rate());
      line.low.push_back(100 * cell->wilson.low);
      line.high.push_back(100 * cell->wilson.high);
    }
    series.push_back(std::move(line));
  }
  LinePlotOptions options = LevelAxis();
  options.title = absl::StrCat(panel.title, " (n = ", CountText(panel), ")");
  options.x_label = absl::StrCat(suite, ", severity level");
  options.width = kPanelWidth;
  options.height = kPanelHeight;
  return LinePlot(series, options);
}

// Average success without Clean over the levels, one line per method.
std::string AveragePlot(const Summary& summary, const std::string& policy) {
  std::map<std::string, LineSeries> lines;  // by method
  CountRange counts;
  for (const SuccessTable& table : summary.tables) {
    if (table.policy != policy || !table.suite.empty()) continue;
    for (const auto& [method, average] : table.averages) {
      if (average.n == 0) continue;
      LineSeries& line =
          lines.try_emplace(method, LineSeries{method, MethodColor(method), {}, {}, {}, {}, ""})
              .first->second;
      line.x.push_back(table.severity);
      line.y.push_back(100 * average.success.estimate);
      line.low.push_back(100 * average.success.interval.low);
      line.high.push_back(100 * average.success.interval.high);
      counts.Add(average.n);
    }
  }
  std::vector<LineSeries> series;
  for (const auto& [method, line] : lines) series.push_back(line);
  LinePlotOptions options = LevelAxis();
  options.title = absl::StrCat("Average without Clean [%], n = ", counts.Text(), " per point");
  options.width = 560;
  options.height = 300;
  return LinePlot(series, options);
}

}  // namespace

std::vector<std::string> PoliciesWithLevels(const Summary& summary) {
  std::vector<std::string> policies;
  std::map<std::string, std::set<int>> levels;
  for (const SuccessTable& table : summary.tables) {
    levels[table.policy].insert(table.severity);
    if (levels[table.policy].size() > 1) AddOnce(policies, table.policy);
  }
  return policies;
}

std::string SeverityFigure(const Summary& summary, const std::string& policy) {
  const std::vector<std::string> policies = PoliciesWithLevels(summary);
  if (std::find(policies.begin(), policies.end(), policy) == policies.end()) return "";
  const PanelGrid grid = CollectPanels(summary, policy);
  std::vector<std::string> plots;
  for (const std::string& scenario : grid.scenarios) {
    for (const std::string& suite : grid.suites) {
      const auto panel = grid.panels.find({scenario, suite});
      plots.push_back(panel == grid.panels.end() ? ""
                                                 : PanelPlot(panel->second, grid.methods, suite));
    }
  }
  PlotSheetOptions options;
  options.title = absl::StrCat("Success [%] of ", policy, " over severity levels");
  for (const std::string& method : grid.methods)
    options.legend.emplace_back(MethodTitle(method), MethodColor(method));
  options.columns = static_cast<int>(grid.suites.size());
  options.plot_width = kPanelWidth;
  options.plot_height = kPanelHeight;
  return PlotSheet(plots, options);
}

std::string SeveritySection(const Summary& summary) {
  std::string html;
  for (const std::string& policy : PoliciesWithLevels(summary)) {
    absl::StrAppend(&html, "<div class=scroll>", SeverityFigure(summary, policy), "</div>",
                    AveragePlot(summary, policy));
  }
  if (html.empty()) return "";
  return absl::StrCat(
      "<h2 id=severity>Severity</h2>\n", html,
      "<p class=note>Bands: Wilson's 95 % intervals, of the average the cluster bootstrap's. n: "
      "episodes of each point. L1 is the mild setting, L5 the paper's tables.</p>\n");
}

}  // namespace robostress
