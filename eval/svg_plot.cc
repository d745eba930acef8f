#include "eval/svg_plot.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"

namespace robostress {
namespace {

constexpr char kInk[] = "#1f2937", kMuted[] = "#6b7280", kGrid[] = "#e5e7eb";
constexpr char kFont[] =
    "font-family=\"system-ui,-apple-system,Segoe UI,Roboto,Helvetica,Arial,sans-serif\"";

std::string Open(int width, int height, const std::string& label) {
  return absl::StrFormat(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" width=\"%d\" height=\"%d\" "
      "role=\"img\" aria-label=\"%s\" %s>"
      "<rect width=\"%d\" height=\"%d\" fill=\"#ffffff\"/>\n",
      width, height, width, height, EscapeXml(label), kFont, width, height);
}

std::string Line(double x1, double y1, double x2, double y2, const char* color, double width,
                 const char* dash = "") {
  return absl::StrFormat(
      "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\" "
      "stroke-width=\"%.1f\"%s/>\n",
      x1, y1, x2, y2, color, width,
      *dash == '\0' ? "" : absl::StrCat(" stroke-dasharray=\"", dash, "\""));
}

std::string Text(double x, double y, const std::string& text, const char* anchor, int size,
                 const char* color, bool bold = false) {
  return absl::StrFormat(
      "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" font-size=\"%d\" fill=\"%s\"%s>%s</text>\n",
      x, y, anchor, size, color, bold ? " font-weight=\"600\"" : "", EscapeXml(text));
}

// Short text of a tick: no trailing zeros.
std::string TickText(double value) {
  const std::string text = absl::StrFormat("%.4g", std::abs(value) < 1e-12 ? 0.0 : value);
  return absl::StrReplaceAll(text, {{"-", "\u2212"}});
}

// Coloured dots with names, left to right from (x, y); wraps at `width`.
std::string Legend(const std::vector<std::pair<std::string, std::string>>& entries, double x,
                   double y, double width) {
  std::string svg;
  double at = x;
  for (const auto& [name, color] : entries) {
    const double length = 34 + 6.2 * name.size();
    if (at > x && at + length > x + width) {
      at = x;
      y += 18;
    }
    absl::StrAppendFormat(&svg, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"4.5\" fill=\"%s\"/>\n", at + 5,
                          y - 4, color);
    svg += Text(at + 14, y, name, "start", 12, kInk);
    at += length;
  }
  return svg;
}

}  // namespace

std::string MethodColor(const std::string& method) {
  static const auto& colors = *new std::map<std::string, std::string>{
      {"base", "#6b7280"},         {"ours", "#0072b2"},
      {"ours_intent", "#d55e00"},  {"ours_nominal", "#009e73"},
      {"gain", "#e69f00"},         {"null", "#cc79a7"},
      {"direct", "#56b4e9"},       {"no_residual", "#8b5cf6"},
      {"no_anchor", "#a16207"},    {"shuffled_instruction", "#be123c"},
      {"blank_images", "#0f766e"}, {"frozen_state", "#4d7c0f"}};
  const auto color = colors.find(method);
  return color == colors.end() ? "#334155" : color->second;
}

std::string EscapeXml(const std::string& text) {
  return absl::StrReplaceAll(text,
                             {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}, {"\"", "&quot;"}});
}

std::vector<double> NiceTicks(double low, double high, int count) {
  std::vector<double> ticks;
  const double raw = (high - low) / std::max(1, count);
  if (!(raw > 0) || !std::isfinite(raw)) return {low};
  const double power = std::pow(10, std::floor(std::log10(raw)));
  double step = 10 * power;
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (factor * power >= raw * 0.999) {
      step = factor * power;
      break;
    }
  }
  for (double i = std::ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; ++i)
    ticks.push_back(i * step);
  return ticks;
}

std::string IntervalPlot(const std::vector<std::string>& categories,
                         const std::vector<IntervalSeries>& series,
                         const IntervalPlotOptions& options) {
  const int width = 860, left = 190, right = 24, top = 44, lane = 13;
  const int band = 14 + lane * static_cast<int>(std::max<size_t>(1, series.size()));
  const int plot_bottom = top + band * static_cast<int>(categories.size());
  const int height = plot_bottom + 46;
  const auto x_of = [&](double value) {
    const double t = (std::clamp(value, options.x_min, options.x_max) - options.x_min) /
                     (options.x_max - options.x_min);
    return left + t * (width - left - right);
  };
  std::string svg = Open(width, height, options.x_label);
  std::vector<std::pair<std::string, std::string>> entries;
  for (const IntervalSeries& s : series) entries.emplace_back(s.name, s.color);
  svg += Legend(entries, left, 24, width - left - right);
  for (const double tick : NiceTicks(options.x_min, options.x_max, 6)) {
    svg += Line(x_of(tick), top, x_of(tick), plot_bottom, kGrid, 1);
    svg += Text(x_of(tick), plot_bottom + 18, TickText(tick), "middle", 12, kMuted);
  }
  if (options.zero_line) svg += Line(x_of(0), top, x_of(0), plot_bottom, kMuted, 1.4);
  svg += Text((left + width - right) / 2.0, plot_bottom + 38, options.x_label, "middle", 12, kInk);
  for (size_t c = 0; c < categories.size(); ++c) {
    const double y0 = top + band * static_cast<double>(c);
    svg += Text(left - 14, y0 + band / 2.0 + 4, categories[c], "end", 13, kInk,
                static_cast<int>(c) > options.separator_after && options.separator_after > 0);
    const bool rule = static_cast<int>(c) == options.separator_after;
    svg += Line(rule ? 8 : left, y0 + band, width - right, y0 + band, rule ? kMuted : kGrid, 1);
    for (size_t s = 0; s < series.size(); ++s) {
      const std::optional<IntervalPoint>& point = series[s].points[c];
      if (!point) continue;
      const double y = y0 + 7 + lane * (s + 0.5);
      if (std::isfinite(point->interval.low)) {
        svg += Line(x_of(point->interval.low), y, x_of(point->interval.high), y,
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
  double x_low = std::numeric_limits<double>::infinity(), x_high = -x_low, y_low = x_low,
         y_high = -x_low;
  for (const LineSeries& s : series) {
    for (size_t i = 0; i < s.x.size(); ++i) {
      if (!std::isfinite(s.y[i])) continue;
      x_low = std::min(x_low, s.x[i]), x_high = std::max(x_high, s.x[i]);
      y_low = std::min(y_low, s.y[i]), y_high = std::max(y_high, s.y[i]);
    }
  }
  if (!std::isfinite(x_low)) x_low = 0, x_high = 1, y_low = 0, y_high = 1;
  y_low = options.y_min.value_or(y_low), y_high = options.y_max.value_or(y_high);
  if (x_high <= x_low) x_high = x_low + 1;
  if (y_high <= y_low) y_high = y_low + 1;
  const double left = options.y_label.empty() ? 52 : 72, right = 14, top = 34,
               bottom = options.height - 42;
  const auto x_of = [&](double x) {
    return left + (x - x_low) / (x_high - x_low) * (options.width - left - right);
  };
  const auto y_of = [&](double y) {
    return bottom - (y - y_low) / (y_high - y_low) * (bottom - top);
  };
  std::string svg = Open(options.width, options.height, options.title);
  svg += Text(left, 20, options.title, "start", 13, kInk, true);
  for (const double tick : NiceTicks(y_low, y_high, 4)) {
    svg += Line(left, y_of(tick), options.width - right, y_of(tick), kGrid, 1);
    svg += Text(left - 7, y_of(tick) + 4, TickText(tick), "end", 11, kMuted);
  }
  for (const double tick : NiceTicks(x_low, x_high, 5)) {
    if (tick == std::floor(tick))
      svg += Text(x_of(tick), bottom + 16, TickText(tick), "middle", 11, kMuted);
  }
  for (const double mark : options.vertical_marks) {
    if (mark > x_low && mark < x_high)
      svg += Line(x_of(mark), top, x_of(mark), bottom, kMuted, 0.8, "3 3");
  }
  svg += Text((left + options.width - right) / 2, options.height - 8, options.x_label, "middle", 11,
              kInk);
  if (!options.y_label.empty()) {
    absl::StrAppendFormat(&svg, "<g transform=\"translate(14 %.1f) rotate(-90)\">%s</g>\n",
                          (top + bottom) / 2, Text(0, 0, options.y_label, "middle", 11, kInk));
  }
  for (const LineSeries& s : series) {
    std::string path, dots;
    bool pen_down = false;
    for (size_t i = 0; i < s.x.size(); ++i) {
      if (!std::isfinite(s.y[i])) {
        pen_down = false;
        continue;
      }
      const double y = y_of(std::clamp(s.y[i], y_low, y_high));
      absl::StrAppendFormat(&path, "%s%.1f %.1f", pen_down ? "L" : "M", x_of(s.x[i]), y);
      if (options.dots)
        absl::StrAppendFormat(&dots, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.4\" fill=\"%s\"/>",
                              x_of(s.x[i]), y, s.color);
      pen_down = true;
    }
    absl::StrAppendFormat(&svg,
                          "<path d=\"%s\" fill=\"none\" stroke=\"%s\" stroke-width=\"2\" "
                          "stroke-linejoin=\"round\"/>%s\n",
                          path, s.color, dots);
  }
  return svg + "</svg>\n";
}

std::string PlotSheet(const std::vector<std::string>& plots, const PlotSheetOptions& options) {
  constexpr int kHead = 52;
  const int rows = static_cast<int>(plots.size() + options.columns - 1) / options.columns;
  std::string svg =
      Open(options.columns * options.plot_width, kHead + rows * options.plot_height, options.title);
  svg += Text(14, 22, options.title, "start", 15, kInk, true);
  svg += Legend(options.legend, 14, 44, options.columns * options.plot_width - 28);
  for (size_t i = 0; i < plots.size(); ++i) {
    const int row = static_cast<int>(i) / options.columns, column = i % options.columns;
    absl::StrAppendFormat(&svg, "<g transform=\"translate(%d %d)\">\n%s</g>\n",
                          column * options.plot_width, kHead + row * options.plot_height, plots[i]);
  }
  return svg + "</svg>\n";
}

}  // namespace robostress
