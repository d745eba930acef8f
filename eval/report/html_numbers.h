#pragma once

#include <optional>
#include <string>

#include "common/statistics.h"

namespace robostress {

// Numbers of a report's page, as HTML: percent with one decimal, a real minus sign, an en dash for
// what was not measured.

std::string Minus(const std::string& text);
std::string Percent(double fraction);  // "56.8"; an en dash for NaN
std::string Signed(double fraction);   // "+2.5", "−1.0" percentage points
std::string OptionalPercent(const std::optional<double>& fraction);
// "[40, 63]", or with signs and a decimal "[−1.0, +4.2]"; "no interval" where there is none.
std::string IntervalHtml(const Interval& interval, bool with_sign);
// A method's title with its colour before it.
std::string MethodLabel(const std::string& method);

}  // namespace robostress
