#pragma once

#include <string>

namespace robostress {

// How names and numbers of a report are written, equal in tables, plots and pages. Methods:
// adapter/methods.h.

// "Heavy Payload" for heavy_payload; the name itself when unknown.
std::string ScenarioTitle(const std::string& scenario);
// A fraction in percentage points without a negative zero.
double PercentagePoints(double fraction);
// "12", "not adapted" (an adapting method without an update), or "-" (a method that does not
// adapt).
std::string UpdatesText(bool adapts, int updates);
// "0.012", "< 0.001", "1"; "-" for NaN.
std::string PValueText(double p_value);
// What stands behind the cells of a row: "160", "80 to 160" where they differ, "-" where there is
// nothing.
class CountRange {
 public:
  void Add(int n);  // 0 is no cell
  std::string Text() const;

 private:
  int low_ = 0, high_ = 0;
};
// "0:42", "12:05", "3:02:10".
std::string FormatDuration(double seconds);

}  // namespace robostress
