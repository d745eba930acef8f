#pragma once

#include <cmath>
#include <string>

#include "common/libero/init_states.h"
#include "tests/fuzz/fuzz_check.h"

namespace robostress::libero {

// Reads `bytes` and checks what ParseInitStates promises of its result or its refusal.
inline void CheckInitStatesOf(const std::string& bytes) {
  const std::string file = "task.pruned_init";
  const absl::StatusOr<InitStates> states = ParseInitStates(file, bytes);
  if (!states.ok()) return CheckRefusal(states.status(), file);
  FuzzCheck(states->rows > 0 && states->columns > 0, "an empty matrix");
  FuzzCheck(states->values.size() == size_t(states->rows) * states->columns,
            "the shape is not the matrix's size");
  for (const double value : states->values) FuzzCheck(std::isfinite(value), "not finite");
  const absl::Status other = CheckInitStates(*states, states->columns, 0);
  FuzzCheck(!other.ok(), "rows of another length are accepted");
  CheckRefusal(other, file);
}

}  // namespace robostress::libero
