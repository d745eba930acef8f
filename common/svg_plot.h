#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/statistics.h"
#include "common/svg_elements.h"

namespace robostress {

// Plots as self-contained SVG text: explicit colours and fonts, no script, no external reference.

struct IntervalPoint {
  double value = 0;
  Interval interval;
};

// One method's points; one entry per category, absent where it was not measured.
struct IntervalSeries {
  std::string name, color;
  std::vector<std::optional<IntervalPoint>> points;
};

struct IntervalPlotOptions {
  std::string x_label;
  double x_min = 0, x_max = 100;
  bool zero_line = false;
  int separator_after = -1;  // draws a rule under this category
};

// Horizontal dots with interval whiskers, categories from top to bottom.
std::string IntervalPlot(const std::vector<std::string>& categories,
                         const std::vector<IntervalSeries>& series,
                         const IntervalPlotOptions& options);

// One line; NaN leaves a gap.
struct LineSeries {
  std::string name, color;
  std::vector<double> x, y;
  std::vector<double> low, high;  // a band behind the line, or empty
  std::string dash;               // as of SVG: "4 3"
};

// Text at the upper end of a vertical mark.
struct MarkLabel {
  double x = 0;
  std::string text;
};

struct LinePlotOptions {
  std::string title, x_label;
  std::string y_label;                 // upright beside the ticks; empty: no room is kept for it
  std::vector<double> vertical_marks;  // dashed, e.g. task boundaries
  std::optional<double> y_min, y_max;  // otherwise from the data
  std::vector<MarkLabel> labels;
  int width = 380, height = 250;
  bool dots = false;
  bool fractional_x_ticks = false;    // otherwise only whole numbers: steps, episodes
  bool log_x = false, log_y = false;  // what is not positive is left out
};

std::string LinePlot(const std::vector<LineSeries>& series, const LinePlotOptions& options);

// One horizontal bar.
struct Bar {
  std::string name, color, note;  // note: after the bar's end
  double value = 0;
};

struct BarPlotOptions {
  std::string title, x_label;
  double x_min = 0;
  std::optional<double> x_max;                             // otherwise from the data
  std::vector<std::pair<double, std::string>> references;  // dashed lines with names
  int width = 560;
};

// Bars from top to bottom.
std::string BarPlot(const std::vector<Bar>& bars, const BarPlotOptions& options);

struct PlotSheetOptions {
  std::string title;
  std::vector<std::pair<std::string, std::string>> legend;  // name, colour
  int columns = 1;
  int plot_width = 380, plot_height = 250;  // of every plot
};

// Plots in rows of `columns` under one title and legend.
std::string PlotSheet(const std::vector<std::string>& plots, const PlotSheetOptions& options);

}  // namespace robostress
