#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "eval/statistics.h"

namespace robostress {

// Plots as self-contained SVG text: explicit colours and fonts, no script, no external reference.

// Colour of a method, equal in every plot; other names get a neutral one.
std::string MethodColor(const std::string& method);

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
};

struct LinePlotOptions {
  std::string title, x_label;
  std::string y_label;                 // upright beside the ticks; empty: no room is kept for it
  std::vector<double> vertical_marks;  // dashed, e.g. task boundaries
  std::optional<double> y_min, y_max;  // otherwise from the data
  int width = 380, height = 250;
  bool dots = false;
};

std::string LinePlot(const std::vector<LineSeries>& series, const LinePlotOptions& options);

struct PlotSheetOptions {
  std::string title;
  std::vector<std::pair<std::string, std::string>> legend;  // name, colour
  int columns = 1;
  int plot_width = 380, plot_height = 250;  // of every plot
};

// Plots in rows of `columns` under one title and legend.
std::string PlotSheet(const std::vector<std::string>& plots, const PlotSheetOptions& options);

// Tick positions at 1, 2 or 5 times a power of ten, about `count` of them, inside [low, high].
std::vector<double> NiceTicks(double low, double high, int count);
std::string EscapeXml(const std::string& text);

}  // namespace robostress
