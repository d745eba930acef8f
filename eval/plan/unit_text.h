#pragma once

#include <map>
#include <string>

#include "absl/status/statusor.h"
#include "common/unit_config.h"
#include "eval/plan/plan.h"

namespace robostress {

// Units of a grid differ in five lines at the head of their configuration (suite, scenario,
// severity, policy, seed); what follows is equal for all units of a suite and method. The two
// classes keep what follows, so that a hundred thousand configurations are written and read as fast
// as their files.

// Writes. One object serves the units of one grid only.
class UnitTexts {
 public:
  // DumpConfig(unit.config), byte by byte.
  std::string Of(const PlannedUnit& unit);

 private:
  std::map<std::string, std::string> tails_;  // by suite and method
  std::map<std::string, std::string> heads_;  // rendered lines by key and value
};

// Reads; the texts may come from anywhere.
class UnitTextReader {
 public:
  // ParseConfig<UnitConfig>(source, text).
  absl::StatusOr<UnitConfig> Read(const std::string& source, const std::string& text);

 private:
  std::map<std::string, UnitConfig> tails_;
  std::map<std::string, UnitConfig> heads_;
};

}  // namespace robostress
