#include "calibration/report/report_plots.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/svg_plot.h"

namespace robostress::calibration {
namespace {

constexpr char kMeasuredColor[] = "#1f2937", kRefittedColor[] = "#94a3b8",
               kScreenedColor[] = "#cbd5e1";
constexpr size_t kMostPoints = 1500;  // of a line; more are thinned out
constexpr size_t kMostBars = 14;

// Every so-many-th point, scaled.
LineSeries Line(const std::string& name, const char* color, const std::vector<double>& x,
                const std::vector<double>& y, double factor) {
  LineSeries line;
  line.name = name, line.color = color;
  const size_t n = std::min(x.size(), y.size()), stride = 1 + n / kMostPoints;
  for (size_t i = 0; i < n; i += stride) {
    line.x.push_back(x[i]);
    line.y.push_back(factor * y[i]);
  }
  return line;
}

std::vector<double> Difference(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> difference;
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i) difference.push_back(a[i] - b[i]);
  return difference;
}

// A tenth of the range on either side, so that lines keep off the frame.
void SetRange(const std::vector<LineSeries>& lines, LinePlotOptions& options) {
  double low = 1e300, high = -1e300;
  for (const LineSeries& line : lines) {
    for (const double y : line.y) {
      if (!std::isfinite(y)) continue;
      low = std::min(low, y), high = std::max(high, y);
    }
  }
  if (low > high) return;
  const double margin = high > low ? 0.1 * (high - low) : 0.5 * std::abs(high) + 1e-12;
  options.y_min = low - margin;
  options.y_max = high + margin;
}

}  // namespace

std::string ExamplePlot(const ExampleReport& example, bool added, const DisplayUnit& unit) {
  if (example.t.size() < 2) return "";
  const double f = unit.factor;
  std::vector<LineSeries> signals = {
      Line("measured", kMeasuredColor, example.t, example.measured, 1),
      Line("declared model", kDeclaredColor, example.t, example.declared, 1)};
  std::vector<LineSeries> residuals = {Line("declared model", kDeclaredColor, example.t,
                                            Difference(example.declared, example.measured), f)};
  PlotSheetOptions sheet;
  sheet.title = absl::StrCat("A stretch of ", FileName(example.log));
  sheet.legend = {{"measured", kMeasuredColor}, {"declared model", kDeclaredColor}};
  if (added) {
    signals.push_back(Line("after", kAfterColor, example.t, example.after, 1));
    residuals.push_back(
        Line("after", kAfterColor, example.t, Difference(example.after, example.measured), f));
    sheet.legend.emplace_back("after calibration", kAfterColor);
  }
  signals[1].dash = "6 3";
  sheet.plot_width = 860;
  sheet.plot_height = 200;
  LinePlotOptions options;
  options.title = "Signal";
  options.x_label = "time [s]";
  options.y_label = f == 1 ? unit.name : unit.name.substr(unit.name.size() > 4 ? 2 : 1);
  options.width = sheet.plot_width;
  options.height = sheet.plot_height;
  options.fractional_x_ticks = true;
  SetRange(signals, options);
  std::vector<std::string> plots = {LinePlot(signals, options)};
  options.title = "Residual: prediction minus measurement";
  options.y_label = unit.name;
  SetRange(residuals, options);
  plots.push_back(LinePlot(residuals, options));
  return PlotSheet(plots, sheet);
}

std::string StructurePlot(const StructureCurve& curve, bool added, const DisplayUnit& unit) {
  if (curve.x.size() < 2) return "";
  std::vector<LineSeries> lines = {
      Line("declared", kDeclaredColor, curve.x, curve.declared, unit.factor)};
  if (added) lines.push_back(Line("after", kAfterColor, curve.x, curve.after, unit.factor));
  LinePlotOptions options;
  options.title = absl::StrCat("against ", curve.against);
  options.x_label = absl::StrCat(curve.against, curve.unit.empty() ? "" : " [" + curve.unit + "]");
  options.y_label = unit.name;
  options.width = 345;
  options.height = 215;
  options.fractional_x_ticks = true;
  options.log_x = options.log_y = curve.against == "frequency";
  if (!options.log_y) SetRange(lines, options);
  return LinePlot(lines, options);
}

bool IsPartOf(const std::string& type, const JointReport& joint) {
  for (const absl::string_view part : absl::StrSplit(type, '+')) {
    if (std::none_of(joint.effects.begin(), joint.effects.end(),
                     [&](const AddedEffectReport& effect) { return effect.type == part; }))
      return false;
  }
  return true;
}

std::string FileName(const std::string& path) {
  const size_t slash = path.find_last_of('/');
  return slash == std::string::npos ? path : path.substr(slash + 1);
}

std::string RoundPlot(const RoundReport& round, int number, const JointReport& joint) {
  if (round.candidates.empty()) return "";
  std::vector<Bar> bars;
  for (const CandidateReport& c : round.candidates) {
    if (bars.size() == kMostBars) break;
    Bar bar;
    bar.name = c.type;
    bar.value = 100 * c.linear_gain;
    const bool kept = c.accepted && IsPartOf(c.type, joint);
    bar.color = kept ? kAfterColor : c.refitted ? kRefittedColor : kScreenedColor;
    bar.note = kept ? "accepted" : c.accepted ? "passes alone" : c.refitted ? "not taken" : "";
    bars.push_back(bar);
  }
  BarPlotOptions options;
  options.title = absl::StrCat("Round ", number, ": what each effect alone could explain");
  options.x_label = "share of the residual's energy [%]";
  options.width = 860;
  if (round.null_99 > 0) {
    options.references = {{100 * round.null_95, "95 % of chance"},
                          {100 * round.null_99, "99 % of chance"}};
  }
  return BarPlot(bars, options);
}

std::string ErrorPlot(const JointReport& joint, const DisplayUnit& unit) {
  const std::pair<const char*, const ErrorReport*> rows[] = {
      {"fitted logs", &joint.fit},
      {"cross-validated", &joint.cross_validated},
      {"held-out logs", &joint.held_out},
      {"unseen regime", &joint.transfer},
      {"whole runs", &joint.full_run}};
  const bool added = !joint.effects.empty();
  std::vector<Bar> bars;
  double floor = 0;
  for (const auto& [name, error] : rows) {
    if (!error->present || error == &joint.full_run) continue;
    const double declared = unit.factor * error->declared, after = unit.factor * error->after;
    bars.push_back({absl::StrCat(name, added ? ", declared" : ""), kDeclaredColor,
                    NumberText(declared), declared});
    if (added) {
      const double change = declared > 0 ? after / declared - 1 : 0;
      bars.push_back(
          {"after", kAfterColor,
           absl::StrCat(NumberText(after), " (", change > 0 ? "+" : "", PercentText(change), ")"),
           after});
    }
    if (floor == 0 || error == &joint.held_out) floor = unit.factor * error->noise_floor;
  }
  if (bars.empty()) return "";
  BarPlotOptions options;
  options.title = "Error of the predictions";
  options.x_label = absl::StrCat("RMS [", unit.name, "]");
  options.width = 860;
  if (floor > 0) options.references = {{floor, absl::StrCat("noise ", NumberText(floor))}};
  return BarPlot(bars, options);
}

}  // namespace robostress::calibration
