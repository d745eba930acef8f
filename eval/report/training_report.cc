#include "eval/report/training_report.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/html_page.h"
#include "common/statistics.h"
#include "common/status_macros.h"
#include "common/svg_plot.h"
#include "nlohmann/json.hpp"
#include "yaml-cpp/yaml.h"

namespace robostress {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
// Okabe and Ito's colours, told apart by everyone.
constexpr const char* kColors[] = {"#0072b2", "#d55e00", "#009e73",
                                   "#cc79a7", "#e69f00", "#56b4e9"};
std::string ColorOf(size_t run) { return kColors[run % std::size(kColors)]; }

// One plot: a column of train.jsonl.
struct Plot {
  const char *column, *title;
  bool dots = false;
};
constexpr Plot kPlots[] = {
    {"flow", "Training loss (flow matching)"},
    {"clean_flow", "The same before PGD (robust)"},
    {"aux", "Auxiliary training loss"},
    {"validation_flow", "Held-out flow loss", true},
    {"action_error", "Held-out action error [command units]", true},
    {"target_error_mm", "Held-out target position error [mm]", true},
};

void Insert(TrainingRun::Column& column, double step, double value) {
  const auto at = std::lower_bound(column.step.begin(), column.step.end(), step);
  const auto index = at - column.step.begin();
  if (at != column.step.end() && *at == step) {
    column.value[index] = value;
    return;
  }
  column.step.insert(at, step);
  column.value.insert(column.value.begin() + index, value);
}

absl::StatusOr<double> BatchOf(const std::string& path, const std::string& config) {
  try {
    return YAML::Load(config)["batch"].as<double>();
  } catch (const YAML::Exception& error) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": batch is missing or not a number: ", error.what()));
  }
}

std::string CurvePlot(const std::vector<TrainingRun>& runs, const Plot& plot) {
  std::vector<LineSeries> series;
  for (size_t i = 0; i < runs.size(); ++i) {
    if (const TrainingRun::Column* column = runs[i].Find(plot.column))
      series.push_back({runs[i].name, ColorOf(i), column->step, column->value});
  }
  if (series.empty()) return "";
  LinePlotOptions options;
  options.title = plot.title;
  options.x_label = "step";
  options.dots = plot.dots;
  return LinePlot(series, options);
}

std::string SuccessPlotOf(const std::vector<TrainingRun>& runs) {
  std::vector<LineSeries> series;
  for (size_t i = 0; i < runs.size(); ++i) {
    const TrainingRun::Column *won = runs[i].Find("successes"), *all = runs[i].Find("episodes");
    if (won == nullptr || all == nullptr || won->step != all->step) continue;
    LineSeries line{runs[i].name, ColorOf(i), won->step, {}};
    for (size_t k = 0; k < won->value.size(); ++k)
      line.y.push_back(100 * won->value[k] / all->value[k]);
    series.push_back(std::move(line));
  }
  if (series.empty()) return "";
  LinePlotOptions options;
  options.title = "Success during training [%]";
  options.x_label = "step";
  options.dots = true;
  options.y_min = 0;
  options.y_max = 100;
  return LinePlot(series, options);
}

std::string Number(const char* format, double value) {
  if (!std::isfinite(value)) return "<td>\u2013</td>";
  char text[64];
  std::snprintf(text, sizeof(text), format, value);
  return absl::StrCat("<td>", text, "</td>");
}

// What a run spent on training, evaluations apart.
struct Cost {
  double frames = 0, cpu_seconds = 0, data_share = kNan;
};

// Sums over the lines of the log; each speaks of the steps since the one before.
Cost CostOf(const TrainingRun& run) {
  const TrainingRun::Column *cpu = run.Find("cpu_ms_per_sample"), *rate = run.Find("samples_per_s"),
                            *share = run.Find("data_share");
  Cost cost;
  if (cpu == nullptr || rate == nullptr || rate->step != cpu->step) return cost;
  double before = 0, seconds = 0, waiting = 0;
  for (size_t i = 0; i < cpu->step.size(); ++i) {
    const double frames = (cpu->step[i] - before) * run.batch;
    before = cpu->step[i];
    cost.frames += frames;
    cost.cpu_seconds += frames * cpu->value[i] * 1e-3;
    seconds += frames / rate->value[i];
    if (share != nullptr && share->step == cpu->step)
      waiting += frames / rate->value[i] * share->value[i];
  }
  if (share != nullptr && seconds > 0) cost.data_share = waiting / seconds;
  return cost;
}

std::string CostTable(const std::vector<TrainingRun>& runs) {
  std::string html =
      "<div class=scroll><table><tr><th>Run</th><th>Steps</th><th>Training loss</th><th>Held-out "
      "loss</th><th>Action error</th><th>Target [mm]</th><th>CPU ms<br><small>per "
      "frame</small></th><th>CPU min</th><th>Data<br><small>% of the "
      "time</small></th><th>Success<br><small>last, 95 %</small></th></tr>\n";
  for (size_t i = 0; i < runs.size(); ++i) {
    const TrainingRun& run = runs[i];
    const Cost cost = CostOf(run);
    absl::StrAppend(&html, "<tr><td><span class=dot style=\"background:", ColorOf(i), "\"></span>",
                    EscapeXml(run.name), "</td>");
    const TrainingRun::Column* flow = run.Find("flow");
    absl::StrAppend(&html, Number("%.0f", flow == nullptr ? kNan : flow->step.back()),
                    Number("%.4f", run.Last("flow")), Number("%.4f", run.Last("validation_flow")),
                    Number("%.4f", run.Last("action_error")),
                    Number("%.1f", run.Last("target_error_mm")),
                    Number("%.2f", 1e3 * cost.cpu_seconds / cost.frames),
                    Number("%.1f", cost.cpu_seconds / 60), Number("%.1f", 100 * cost.data_share));
    const double won = run.Last("successes"), all = run.Last("episodes");
    if (std::isfinite(won) && all > 0) {
      const Interval interval = WilsonInterval(static_cast<int>(won), static_cast<int>(all));
      absl::StrAppendFormat(&html, "<td>%.0f/%.0f<span class=ci>[%.0f, %.0f] %%</span></td></tr>\n",
                            won, all, 100 * interval.low, 100 * interval.high);
    } else {
      html += "<td>\u2013</td></tr>\n";
    }
  }
  return html + "</table></div>\n";
}

}  // namespace

const TrainingRun::Column* TrainingRun::Find(const std::string& column) const {
  const auto found = columns.find(column);
  return found == columns.end() || found->second.step.empty() ? nullptr : &found->second;
}

double TrainingRun::Last(const std::string& column) const {
  const Column* found = Find(column);
  return found == nullptr ? kNan : found->value.back();
}

absl::StatusOr<TrainingRun> LoadTrainingRun(const std::string& dir) {
  TrainingRun run;
  run.dir = dir;
  const std::filesystem::path path = std::filesystem::path(dir).lexically_normal();
  run.name = (path.has_filename() ? path.filename() : path.parent_path().filename()).string();
  const std::string log = dir + "/train.jsonl";
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(log));
  RS_ASSIGN_OR_RETURN(run.config, ReadFile(dir + "/config.yaml"));
  RS_ASSIGN_OR_RETURN(run.batch, BatchOf(dir + "/config.yaml", run.config));
  std::istringstream lines(text);
  int64_t number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++number;
    const nlohmann::json row = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
    if (!row.is_object() || !row.contains("step") || !row["step"].is_number()) {
      return absl::InvalidArgumentError(absl::StrCat(
          log, ":", number, ": not a line of a training log: '", line.substr(0, 60), "'"));
    }
    const double step = row["step"].get<double>();
    for (const auto& [key, value] : row.items()) {
      if (key != "step" && value.is_number()) Insert(run.columns[key], step, value.get<double>());
    }
  }
  if (run.columns.empty())
    return absl::FailedPreconditionError(absl::StrCat(log, ": no step is logged yet"));
  return run;
}

std::string TrainingSection(const std::vector<TrainingRun>& runs) {
  std::vector<std::string> plots;
  const std::string success = SuccessPlotOf(runs);
  if (!success.empty()) plots.push_back(success);
  for (const Plot& plot : kPlots) {
    const std::string svg = CurvePlot(runs, plot);
    if (!svg.empty()) plots.push_back(svg);
  }
  std::string html = "<h2 id=training>Training</h2>\n" + CostTable(runs) + "<div class=panels>";
  for (const std::string& plot : plots) html += plot;
  html +=
      "</div>\n<p class=note>Training loss: mean since the line of the log before; with objective "
      "robust of the worst chunk in the ball. Held out are whole episodes. Success is of the "
      "averaged weights of that step, as the evaluation command measured it; the interval is "
      "Wilson's. CPU time is of training alone; data: share of the threads' time that was spent "
      "on loading and augmenting frames.</p>\n";
  for (const TrainingRun& run : runs) {
    absl::StrAppend(&html, "<details><summary>", EscapeXml(run.name),
                    ": configuration</summary><pre>", EscapeXml(run.config), "</pre></details>\n");
  }
  return html;
}

std::string TrainingPage(const std::vector<TrainingRun>& runs) {
  std::string html = PageHead("RoboStress training");
  absl::StrAppend(&html,
                  "<header><div class=wrap><h1>RoboStress: training of the embedded policy</h1><p>",
                  runs.size(), runs.size() == 1 ? " run" : " runs",
                  "</p></div></header>\n<main class=wrap>\n", TrainingSection(runs),
                  "</main><footer><div class=wrap>Written by <code>robostress report "
                  "--training</code> from train.jsonl.</div></footer></body></html>\n");
  return html;
}

}  // namespace robostress
