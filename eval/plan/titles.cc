#include "eval/plan/titles.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/joint_errors/scenario_file.h"
#include "common/unit/robots.h"

namespace robostress {

std::string ScenarioTitle(const std::string& scenario) {
  if (std::string arm = ArmTitle(scenario); !arm.empty()) return arm;
  const absl::StatusOr<Scenario> row = MakeScenario(scenario, 5);
  return row.ok() ? row->title : ScenarioLabel(scenario);
}

double PercentagePoints(double fraction) {
  return std::abs(fraction) < 0.0005 ? 0.0 : 100 * fraction;
}

std::string UpdatesText(bool adapts, int updates) {
  if (!adapts) return "-";
  return updates == 0 ? "not adapted" : absl::StrCat(updates);
}

std::string PValueText(double p_value) {
  if (!std::isfinite(p_value)) return "-";
  if (p_value < 0.001) return "< 0.001";
  return p_value >= 0.9995 ? "1" : absl::StrFormat("%.3f", p_value);
}

void CountRange::Add(int n) {
  if (n == 0) return;
  low_ = high_ == 0 ? n : std::min(low_, n);
  high_ = std::max(high_, n);
}

std::string CountRange::Text() const {
  if (high_ == 0) return "-";
  return low_ == high_ ? absl::StrCat(low_) : absl::StrCat(low_, " to ", high_);
}

std::string FormatDuration(double seconds) {
  const int64_t total = std::llround(std::max(0.0, seconds));
  if (total < 3600) return absl::StrFormat("%d:%02d", total / 60, total % 60);
  return absl::StrFormat("%d:%02d:%02d", total / 3600, total / 60 % 60, total % 60);
}

}  // namespace robostress
