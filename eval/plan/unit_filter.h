#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/plan/plan.h"

namespace robostress {

// The units that `conditions` leave, in their order. A condition is "key=pattern" with key suite,
// scenario, severity, policy, method, seed or unit (the id) and a pattern of the shell ("aged_*").
// Conditions with one key are alternatives; those with different keys must all hold. Without
// conditions: all units. InvalidArgument, with everything listed: unknown keys, and patterns that
// no unit has, with what there is.
absl::StatusOr<std::vector<PlannedUnit>> FilterUnits(std::vector<PlannedUnit> units,
                                                     const std::vector<std::string>& conditions);

}  // namespace robostress
