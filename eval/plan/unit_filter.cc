#include "eval/plan/unit_filter.h"

#include <fnmatch.h>

#include <algorithm>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/joint_errors/scenario_file.h"

namespace robostress {
namespace {

constexpr const char* kKeys[] = {"suite",  "scenario", "severity", "policy",
                                 "method", "seed",     "unit"};

std::string ValueOf(const PlannedUnit& unit, const std::string& key) {
  const UnitConfig& config = unit.config;
  if (key == "suite") return config.suite;
  if (key == "scenario") return ScenarioLabel(config.scenario);
  if (key == "severity") return absl::StrCat(config.severity);
  if (key == "policy") return PolicyLabel(config.policy);
  if (key == "method") return config.method->method;
  if (key == "seed") return absl::StrCat(config.seed);
  return unit.id;
}

bool Matches(const std::string& pattern, const std::string& value) {
  return fnmatch(pattern.c_str(), value.c_str(), 0) == 0;
}

std::string Known(const std::set<std::string>& values) {
  constexpr size_t kShown = 12;
  std::vector<std::string> shown(values.begin(), values.end());
  if (shown.size() > kShown) {
    shown.resize(kShown);
    shown.push_back(absl::StrCat("... (", values.size(), ")"));
  }
  return absl::StrJoin(shown, ", ");
}

}  // namespace

absl::StatusOr<std::vector<PlannedUnit>> FilterUnits(std::vector<PlannedUnit> units,
                                                     const std::vector<std::string>& conditions) {
  std::map<std::string, std::vector<std::string>> patterns;
  std::vector<std::string> complaints;
  for (const std::string& condition : conditions) {
    const size_t equals = condition.find('=');
    const std::string key = condition.substr(0, equals);
    if (equals == std::string::npos ||
        std::find(std::begin(kKeys), std::end(kKeys), key) == std::end(kKeys)) {
      complaints.push_back(absl::StrCat(
          "'", condition, "' is no KEY=PATTERN with a key of: ", absl::StrJoin(kKeys, ", ")));
    } else {
      patterns[key].push_back(condition.substr(equals + 1));
    }
  }
  for (const auto& [key, alternatives] : patterns) {
    std::set<std::string> values;
    for (const PlannedUnit& unit : units) values.insert(ValueOf(unit, key));
    for (const std::string& pattern : alternatives) {
      const bool found = std::any_of(values.begin(), values.end(), [&](const std::string& value) {
        return Matches(pattern, value);
      });
      if (!found) {
        complaints.push_back(absl::StrCat("no unit of the grid has ", key, " '", pattern,
                                          "'; it has: ", Known(values)));
      }
    }
  }
  if (!complaints.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("the filter cannot be applied:\n  - ", absl::StrJoin(complaints, "\n  - ")));
  }
  const auto excluded = [&](const PlannedUnit& unit) {
    return std::any_of(patterns.begin(), patterns.end(), [&](const auto& entry) {
      const std::string value = ValueOf(unit, entry.first);
      return std::none_of(entry.second.begin(), entry.second.end(),
                          [&](const std::string& pattern) { return Matches(pattern, value); });
    });
  };
  units.erase(std::remove_if(units.begin(), units.end(), excluded), units.end());
  if (units.empty() && !conditions.empty())
    return absl::InvalidArgumentError(
        "the filter leaves no unit: its conditions exclude each other");
  return units;
}

}  // namespace robostress
