#pragma once

#include <string>

namespace robostress::calibration {

// Numbers as people read them.

// Three significant digits, powers of ten as such, a true minus; "–" where there is no number.
std::string NumberText(double value);
// A value with its standard deviation, both to the second digit of the deviation: "12.34 ± 0.56".
// The value alone where std is zero.
std::string ValueText(double value, double std);
// "41 %", "0.3 %"; a true minus.
std::string PercentText(double fraction);
// "p = 0.004"; the least that `n_surrogates` can tell is written as a bound: "p ≤ 0.001".
std::string PValueText(double p, int n_surrogates);

// A unit in which a typical size has a handy number: rad to mrad, m to mm, and so on.
struct DisplayUnit {
  std::string name;
  double factor = 1;  // from the report's unit to this one
};
DisplayUnit DisplayUnitFor(const std::string& unit, double typical);

}  // namespace robostress::calibration
