#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"

namespace robostress::openpi {

// OK without problems; else "FILE: WHAT, 3 problems:" with one line each, and what to do about
// them.
absl::Status ProblemList(const std::string& file, const std::string& what,
                         const std::vector<std::string>& problems, const std::string& remedy);

}  // namespace robostress::openpi
