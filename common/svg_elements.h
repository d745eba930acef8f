#pragma once

#include <string>
#include <utility>
#include <vector>

namespace robostress {

// What plots are drawn from: SVG text with explicit colours and fonts, no script, no external
// reference. Pages recolour these for dark screens (common/html_page.h).
inline constexpr char kSvgInk[] = "#1f2937", kSvgMuted[] = "#6b7280", kSvgGrid[] = "#e5e7eb";

// A picture on white; `label` is what a screen reader says. Close it with "</svg>\n".
std::string SvgOpen(int width, int height, const std::string& label);
std::string SvgLine(double x1, double y1, double x2, double y2, const char* color, double width,
                    const char* dash = "");
// anchor: start, middle or end of the text stands at (x, y).
std::string SvgText(double x, double y, const std::string& text, const char* anchor, int size,
                    const char* color, bool bold = false);
// Coloured dots with names (name, colour), left to right from (x, y); wraps at `width`.
std::string SvgLegend(const std::vector<std::pair<std::string, std::string>>& entries, double x,
                      double y, double width);
// Short text of a tick: no trailing zeros.
std::string TickText(double value);

// Tick positions at 1, 2 or 5 times a power of ten, about `count` of them, inside [low, high].
std::vector<double> NiceTicks(double low, double high, int count);
std::string EscapeXml(const std::string& text);

}  // namespace robostress
