#include "common/svg_plot.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/svg_elements.h"

namespace robostress {
namespace {

// From values in [low, high] to places in [from, to] of a picture.
struct Axis {
  bool log = false;
  double low = 0, high = 1, from = 0, to = 1;

  // A range that has some length.
  void Widen() {
    if (high <= low) high = log ? 10 * low : low + 1;
  }
  double At(double value) const {
    const double t =
        log ? std::log(value / low) / std::log(high / low) : (value - low) / (high - low);
    return from + t * (to - from);
  }
  // Of a logarithmic axis powers of ten, and 2 and 5 times them where there are few.
  std::vector<double> Ticks(int count) const {
    if (!log) return NiceTicks(low, high, count);
    std::vector<double> ticks;
    const bool few = high < 300 * low;
    for (int e = static_cast<int>(std::floor(std::log10(low))); e <= std::log10(high); ++e) {
      for (const double factor : {1.0, 2.0, 5.0}) {
        const double tick = factor * std::pow(10, e);
        if ((factor == 1 || few) && tick >= low && tick <= high) ticks.push_back(tick);
      }
    }
    return ticks;
  }
};

}  // namespace
std::string IntervalPlot(const std::vector<std::string>& categories,
                         const std::vector<IntervalSeries>& series,
                         const IntervalPlotOptions& options) {
  size_t longest = 0;  // bytes, which is what names of scenarios have as many of as columns
  for (const std::string& category : categories) longest = std::max(longest, category.size());
  const int width = 860, left = std::max(190, 24 + static_cast<int>(7.9 * longest)), right = 24,
            top = 44, lane = 13;
  const int band = 14 + lane * static_cast<int>(std::max<size_t>(1, series.size()));
  const int plot_bottom = top + band * static_cast<int>(categories.size());
  const int height = plot_bottom + 46;
  const auto x_of = [&](double value) {
    const double t = (std::clamp(value, options.x_min, options.x_max) - options.x_min) /
                     (options.x_max - options.x_min);
    return left + t * (width - left - right);
  };
  std::string svg = SvgOpen(width, height, options.x_label);
  std::vector<std::pair<std::string, std::string>> entries;
  for (const IntervalSeries& s : series) entries.emplace_back(s.name, s.color);
  svg += SvgLegend(entries, left, 24, width - left - right);
  for (const double tick : NiceTicks(options.x_min, options.x_max, 6)) {
    svg += SvgLine(x_of(tick), top, x_of(tick), plot_bottom, kSvgGrid, 1);
    svg += SvgText(x_of(tick), plot_bottom + 18, TickText(tick), "middle", 12, kSvgMuted);
  }
  if (options.zero_line) svg += SvgLine(x_of(0), top, x_of(0), plot_bottom, kSvgMuted, 1.4);
  svg += SvgText((left + width - right) / 2.0, plot_bottom + 38, options.x_label, "middle", 12,
                 kSvgInk);
  for (size_t c = 0; c < categories.size(); ++c) {
    const double y0 = top + band * static_cast<double>(c);
    svg += SvgText(left - 14, y0 + band / 2.0 + 4, categories[c], "end", 13, kSvgInk,
                   static_cast<int>(c) > options.separator_after && options.separator_after > 0);
    const bool rule = static_cast<int>(c) == options.separator_after;
    svg += SvgLine(rule ? 8 : left, y0 + band, width - right, y0 + band,
                   rule ? kSvgMuted : kSvgGrid, 1);
    for (size_t s = 0; s < series.size(); ++s) {
      const std::optional<IntervalPoint>& point = series[s].points[c];
      if (!point) continue;
      const double y = y0 + 7 + lane * (s + 0.5);
      if (std::isfinite(point->interval.low)) {
        svg += SvgLine(x_of(point->interval.low), y, x_of(point->interval.high), y,
                       series[s].color.c_str(), 2.2);
      }
      absl::StrAppendFormat(&svg,
                            "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"4.6\" fill=\"%s\" "
                            "stroke=\"#ffffff\" stroke-width=\"1\"/>\n",
                            x_of(point->value), y, series[s].color);
    }
  }
  return svg + "</svg>\n";
}

std::string LinePlot(const std::vector<LineSeries>& series, const LinePlotOptions& options) {
  const auto shown = [&](double x, double y) {
    return std::isfinite(x) && std::isfinite(y) && !(options.log_x && x <= 0) &&
           !(options.log_y && y <= 0);
  };
  double x_low = std::numeric_limits<double>::infinity(), x_high = -x_low, y_low = x_low,
         y_high = -x_low;
  for (const LineSeries& s : series) {
    for (const std::vector<double>* y : {&s.y, &s.low, &s.high}) {
      for (size_t i = 0; i < y->size(); ++i) {
        if (!shown(s.x[i], (*y)[i])) continue;
        x_low = std::min(x_low, s.x[i]), x_high = std::max(x_high, s.x[i]);
        y_low = std::min(y_low, (*y)[i]), y_high = std::max(y_high, (*y)[i]);
      }
    }
  }
  const double left = options.y_label.empty() ? 52 : 72, right = 14, top = 34,
               bottom = options.height - 42;
  if (!std::isfinite(x_low)) x_low = options.log_x, x_high = 1, y_low = options.log_y, y_high = 1;
  Axis x_axis{options.log_x, x_low, x_high, left, options.width - right};
  Axis y_axis{options.log_y, options.y_min.value_or(y_low), options.y_max.value_or(y_high), bottom,
              top};
  x_axis.Widen();
  y_axis.Widen();
  const auto x_of = [&](double x) { return x_axis.At(x); };
  const auto y_of = [&](double y) { return y_axis.At(std::clamp(y, y_axis.low, y_axis.high)); };
  std::string svg = SvgOpen(options.width, options.height, options.title);
  svg += SvgText(left, 20, options.title, "start", 13, kSvgInk, true);
  for (const double tick : y_axis.Ticks(4)) {
    svg += SvgLine(left, y_of(tick), options.width - right, y_of(tick), kSvgGrid, 1);
    svg += SvgText(left - 7, y_of(tick) + 4, TickText(tick), "end", 11, kSvgMuted);
  }
  for (const double tick : x_axis.Ticks(5)) {
    if (options.fractional_x_ticks || options.log_x || tick == std::floor(tick))
      svg += SvgText(x_of(tick), bottom + 16, TickText(tick), "middle", 11, kSvgMuted);
  }
  for (const double mark : options.vertical_marks) {
    if (mark > x_axis.low && mark < x_axis.high)
      svg += SvgLine(x_of(mark), top, x_of(mark), bottom, kSvgMuted, 0.8, "3 3");
  }
  for (const MarkLabel& label : options.labels)
    svg += SvgText(x_of(label.x) + 5, top + 11, label.text, "start", 11, kSvgMuted);
  svg += SvgText((left + options.width - right) / 2, options.height - 8, options.x_label, "middle",
                 11, kSvgInk);
  if (!options.y_label.empty()) {
    absl::StrAppendFormat(&svg, "<g transform=\"translate(14 %.1f) rotate(-90)\">%s</g>\n",
                          (top + bottom) / 2,
                          SvgText(0, 0, options.y_label, "middle", 11, kSvgInk));
  }
  for (const LineSeries& s : series) {
    std::string upper, lower;
    for (size_t i = 0; i < s.low.size(); ++i) {
      if (!shown(s.x[i], s.low[i]) || !shown(s.x[i], s.high[i])) continue;
      absl::StrAppendFormat(&upper, "%s%.1f %.1f", upper.empty() ? "M" : "L", x_of(s.x[i]),
                            y_of(s.high[i]));
      lower.insert(0, absl::StrFormat("L%.1f %.1f", x_of(s.x[i]), y_of(s.low[i])));
    }
    if (!upper.empty()) {
      absl::StrAppendFormat(&svg, "<path d=\"%s%sZ\" fill=\"%s\" fill-opacity=\"0.16\"/>\n", upper,
                            lower, s.color);
    }
  }
  for (const LineSeries& s : series) {
    std::string path, dots;
    bool pen_down = false;
    for (size_t i = 0; i < s.x.size(); ++i) {
      if (!shown(s.x[i], s.y[i])) {
        pen_down = false;
        continue;
      }
      absl::StrAppendFormat(&path, "%s%.1f %.1f", pen_down ? "L" : "M", x_of(s.x[i]), y_of(s.y[i]));
      if (options.dots)
        absl::StrAppendFormat(&dots, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.4\" fill=\"%s\"/>",
                              x_of(s.x[i]), y_of(s.y[i]), s.color);
      pen_down = true;
    }
    absl::StrAppendFormat(&svg,
                          "<path d=\"%s\" fill=\"none\" stroke=\"%s\" stroke-width=\"2\" "
                          "stroke-linejoin=\"round\"%s/>%s\n",
                          path, s.color,
                          s.dash.empty() ? "" : absl::StrCat(" stroke-dasharray=\"", s.dash, "\""),
                          dots);
  }
  return svg + "</svg>\n";
}

std::string BarPlot(const std::vector<Bar>& bars, const BarPlotOptions& options) {
  size_t longest = 0;
  double high = options.x_min;
  for (const Bar& bar : bars) {
    longest = std::max(longest, bar.name.size());
    high = std::max(high, bar.value);
  }
  for (const auto& [value, name] : options.references) high = std::max(high, value);
  const int left = 24 + static_cast<int>(6.4 * static_cast<double>(longest)), right = 120, top = 52,
            band = 19;
  const int bottom = top + band * static_cast<int>(bars.size());
  Axis axis{false, options.x_min, options.x_max.value_or(high), static_cast<double>(left),
            static_cast<double>(options.width - right)};
  axis.Widen();
  const auto x_of = [&](double x) { return axis.At(std::clamp(x, axis.low, axis.high)); };
  std::string svg = SvgOpen(options.width, bottom + 44, options.title);
  svg += SvgText(8, 20, options.title, "start", 13, kSvgInk, true);
  for (const double tick : axis.Ticks(4)) {
    svg += SvgLine(x_of(tick), top, x_of(tick), bottom, kSvgGrid, 1);
    svg += SvgText(x_of(tick), bottom + 16, TickText(tick), "middle", 11, kSvgMuted);
  }
  double label_end = -1e9;
  int lane = 0;
  for (const auto& [value, name] : options.references) {
    const double x = x_of(value);
    lane = x < label_end ? 1 - lane : 0;
    label_end = x + 8 + 6.2 * static_cast<double>(name.size());
    svg += SvgLine(x, top - 4, x, bottom, kSvgInk, 1.2, "4 3");
    svg += SvgText(x, top - 8 - 13 * lane, name, "start", 11, kSvgInk);
  }
  for (size_t i = 0; i < bars.size(); ++i) {
    const double y = top + band * static_cast<double>(i);
    svg += SvgText(left - 8, y + 13.5, bars[i].name, "end", 12, kSvgInk);
    if (std::isfinite(bars[i].value)) {
      absl::StrAppendFormat(&svg,
                            "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"11\" rx=\"1.5\" "
                            "fill=\"%s\"/>\n",
                            x_of(axis.low), y + 4,
                            std::max(0.0, x_of(bars[i].value) - x_of(axis.low)), bars[i].color);
      absl::StrAppendFormat(  // outlined in paper's colour, so that it reads on a dashed line
          &svg, "<g stroke=\"#ffffff\" stroke-width=\"4\" paint-order=\"stroke\">%s</g>\n",
          SvgText(x_of(bars[i].value) + 6, y + 13.5, bars[i].note, "start", 11, kSvgMuted));
    }
  }
  svg += SvgText((left + options.width - right) / 2.0, bottom + 35, options.x_label, "middle", 11,
                 kSvgInk);
  return svg + "</svg>\n";
}

std::string PlotSheet(const std::vector<std::string>& plots, const PlotSheetOptions& options) {
  constexpr int kHead = 52;
  const int rows = static_cast<int>(plots.size() + options.columns - 1) / options.columns;
  std::string svg = SvgOpen(options.columns * options.plot_width,
                            kHead + rows * options.plot_height, options.title);
  svg += SvgText(14, 22, options.title, "start", 15, kSvgInk, true);
  svg += SvgLegend(options.legend, 14, 44, options.columns * options.plot_width - 28);
  for (size_t i = 0; i < plots.size(); ++i) {
    const int row = static_cast<int>(i) / options.columns, column = i % options.columns;
    absl::StrAppendFormat(&svg, "<g transform=\"translate(%d %d)\">\n%s</g>\n",
                          column * options.plot_width, kHead + row * options.plot_height, plots[i]);
  }
  return svg + "</svg>\n";
}

}  // namespace robostress
