#pragma once

#include "absl/status/statusor.h"
#include "common/joint_errors/joint_chain.h"
#include "python/library/robostress.h"

namespace robostress {

// The errors of a scenario at an arm of `joints`, 1 to 64. Errors name the option, its value and
// what is allowed.
absl::StatusOr<JointChain> MakeChain(const char* scenario, int joints,
                                     const robostress_options& options);

}  // namespace robostress
