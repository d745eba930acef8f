#include "eval/report/html_numbers.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "adapter/methods.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"

namespace robostress {

std::string Minus(const std::string& text) { return absl::StrReplaceAll(text, {{"-", "\u2212"}}); }

std::string Percent(double fraction) {
  return std::isfinite(fraction) ? absl::StrFormat("%.1f", 100 * fraction) : "\u2013";
}

std::string Signed(double fraction) {
  return Minus(absl::StrFormat("%+.1f", PercentagePoints(fraction)));
}

std::string OptionalPercent(const std::optional<double>& fraction) {
  return fraction ? Percent(*fraction) : "\u2013";
}

std::string IntervalHtml(const Interval& interval, bool with_sign) {
  if (!std::isfinite(interval.low)) return "no interval";
  return Minus(with_sign
                   ? absl::StrFormat("[%+.1f, %+.1f]", PercentagePoints(interval.low),
                                     PercentagePoints(interval.high))
                   : absl::StrFormat("[%.0f, %.0f]", 100 * interval.low, 100 * interval.high));
}

std::string MethodLabel(const std::string& method) {
  return absl::StrCat("<span class=dot style=\"background:", MethodColor(method), "\"></span>",
                      EscapeXml(MethodTitle(method)));
}

}  // namespace robostress
