#include "calibration/report/report_numbers.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"

namespace robostress::calibration {
namespace {

constexpr char kNothing[] = "\u2013";

std::string Minus(const std::string& text) { return absl::StrReplaceAll(text, {{"-", "\u2212"}}); }

// Exponent of the first significant digit.
int Exponent(double value) { return static_cast<int>(std::floor(std::log10(std::abs(value)))); }

std::string Superscript(int exponent) {
  return absl::StrReplaceAll(absl::StrCat(exponent), {{"-", "\u207b"},
                                                      {"0", "\u2070"},
                                                      {"1", "\u00b9"},
                                                      {"2", "\u00b2"},
                                                      {"3", "\u00b3"},
                                                      {"4", "\u2074"},
                                                      {"5", "\u2075"},
                                                      {"6", "\u2076"},
                                                      {"7", "\u2077"},
                                                      {"8", "\u2078"},
                                                      {"9", "\u2079"}});
}

}  // namespace

std::string NumberText(double value) {
  if (!std::isfinite(value)) return kNothing;
  if (value == 0) return "0";
  const int exponent = Exponent(value);
  if (exponent < -4 || exponent > 5) {
    return Minus(absl::StrFormat("%.2f", value / std::pow(10, exponent))) + "\u00b710" +
           Superscript(exponent);
  }
  return Minus(absl::StrFormat("%.*f", std::clamp(2 - exponent, 0, 7), value));
}

std::string ValueText(double value, double std) {
  if (!std::isfinite(value)) return kNothing;
  if (!(std > 0) || !std::isfinite(std)) return NumberText(value);
  const int last = Exponent(std) - 1;  // the second digit of std
  const int first = std::max(value == 0 ? last : Exponent(value), last + 1);
  if (first < -4 || first > 5) {
    const double power = std::pow(10, first);
    const int digits = std::max(0, first - last);
    return absl::StrFormat("(%s \u00b1 %.*f)\u00b710%s",
                           Minus(absl::StrFormat("%.*f", digits, value / power)), digits,
                           std / power, Superscript(first));
  }
  const int digits = std::clamp(-last, 0, 7);
  return Minus(absl::StrFormat("%.*f", digits, value)) +
         absl::StrFormat(" \u00b1 %.*f", digits, std);
}

std::string PercentText(double fraction) {
  if (!std::isfinite(fraction)) return kNothing;
  const double percent = 100 * fraction;
  return Minus(absl::StrFormat("%.*f %%", std::abs(percent) < 9.95 ? 1 : 0, percent));
}

std::string PValueText(double p, int n_surrogates) {
  if (!std::isfinite(p)) return kNothing;
  const double least = 1.0 / (n_surrogates + 1);
  if (n_surrogates > 0 && p <= 1.001 * least)
    return absl::StrCat("p \u2264 ", absl::StrFormat("%.1g", least));
  return absl::StrCat("p = ", absl::StrFormat("%.*f", p < 0.01 ? 3 : 2, p));
}

DisplayUnit DisplayUnitFor(const std::string& unit, double typical) {
  const bool scalable = unit == "rad" || unit == "m";
  const double size = std::abs(typical);
  if (!scalable || !(size > 0) || size >= 0.1) return {unit, 1};
  if (size < 1e-4) return {"\u00b5" + unit, 1e6};
  return {"m" + unit, 1e3};
}

}  // namespace robostress::calibration
