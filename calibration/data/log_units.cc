#include "calibration/data/log_units.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"

namespace robostress::calibration {
namespace {

constexpr double kFewestCounts = 100;  // from the lowest to the highest

bool IsNear(double ratio, double unit, double tolerance) {
  return std::abs(std::log(ratio / unit)) < std::log1p(tolerance);
}

std::string Mend(const std::string& unit, double ratio) {
  return absl::StrFormat("%s: multiply them by %.6g", unit, 1 / ratio);
}

}  // namespace

std::string UnitOfRatio(double ratio, double tolerance) {
  if (!(ratio > 0)) return "";
  if (IsNear(ratio, 180 / M_PI, tolerance)) return Mend("degrees", 180 / M_PI);
  for (int bits = 10; bits <= 24; ++bits) {
    const double counts = std::pow(2.0, bits) / (2 * M_PI);
    if (IsNear(ratio, counts, std::min(tolerance, 0.05)))
      return Mend(absl::StrFormat("counts of an encoder with %.0f a turn", std::pow(2.0, bits)),
                  counts);
  }
  if (IsNear(ratio, 1000, tolerance)) return Mend("thousandths", 1000);
  return "";
}

std::string FaultOfVelocity(double ratio, double tolerance) {
  if (std::string unit = UnitOfRatio(ratio, tolerance); !unit.empty())
    return "its numbers are " + unit;
  if (ratio > 0 && IsNear(ratio, 30 / M_PI, tolerance))
    return "its numbers are " + Mend("turns a minute", 30 / M_PI);
  if (ratio < 0 && IsNear(-ratio, 1, tolerance))
    return "it counts the other way: multiply them by -1";
  if (ratio > 0 && IsNear(ratio, 1, 1)) return "";
  return "that is no velocity of this joint's motor at the joint: another channel, or a gear "
         "between";
}

std::string UnitOfClock(double ratio, double tolerance) {
  if (IsNear(ratio, 1e3, tolerance)) return Mend("milliseconds", 1e3);
  if (IsNear(ratio, 1e6, tolerance)) return Mend("microseconds", 1e6);
  if (IsNear(ratio, 1e9, tolerance)) return Mend("nanoseconds", 1e9);
  return "";
}

bool AreCounts(const std::vector<double>& readings) {
  if (readings.empty()) return false;
  const auto [low, high] = std::minmax_element(readings.begin(), readings.end());
  return *high - *low >= kFewestCounts &&
         std::all_of(readings.begin(), readings.end(),
                     [](double reading) { return reading == std::round(reading); });
}

}  // namespace robostress::calibration
