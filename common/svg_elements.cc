#include "common/svg_elements.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"

namespace robostress {
namespace {

constexpr char kFont[] =
    "font-family=\"system-ui,-apple-system,Segoe UI,Roboto,Helvetica,Arial,sans-serif\"";

}  // namespace

std::string EscapeXml(const std::string& text) {
  return absl::StrReplaceAll(text,
                             {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}, {"\"", "&quot;"}});
}

std::string SvgOpen(int width, int height, const std::string& label) {
  return absl::StrFormat(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" width=\"%d\" height=\"%d\" "
      "role=\"img\" aria-label=\"%s\" %s>"
      "<rect width=\"%d\" height=\"%d\" fill=\"#ffffff\"/>\n",
      width, height, width, height, EscapeXml(label), kFont, width, height);
}

std::string SvgLine(double x1, double y1, double x2, double y2, const char* color, double width,
                    const char* dash) {
  return absl::StrFormat(
      "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\" "
      "stroke-width=\"%.1f\"%s/>\n",
      x1, y1, x2, y2, color, width,
      *dash == '\0' ? "" : absl::StrCat(" stroke-dasharray=\"", dash, "\""));
}

std::string SvgText(double x, double y, const std::string& text, const char* anchor, int size,
                    const char* color, bool bold) {
  return absl::StrFormat(
      "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" font-size=\"%d\" fill=\"%s\"%s>%s</text>\n",
      x, y, anchor, size, color, bold ? " font-weight=\"600\"" : "", EscapeXml(text));
}

std::string TickText(double value) {
  const std::string text = absl::StrFormat("%.4g", std::abs(value) < 1e-12 ? 0.0 : value);
  return absl::StrReplaceAll(text, {{"-", "\u2212"}});
}

std::string SvgLegend(const std::vector<std::pair<std::string, std::string>>& entries, double x,
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
    svg += SvgText(at + 14, y, name, "start", 12, kSvgInk);
    at += length;
  }
  return svg;
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

}  // namespace robostress
