#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/method_options.h"
#include "eval/plan/plan.h"

namespace robostress {

// A grid's overrides by what they concern; "method.x=y" and "remote.x=y" without their section.
struct GridOverrides {
  std::vector<std::string> others, method, remote;
};
GridOverrides PartOverrides(const SweepGrid& grid);

// The preset with the grid's overrides; an error where it would refuse to run.
absl::StatusOr<MethodOptions> MethodOf(const SweepGrid& grid, const std::string& name);

}  // namespace robostress
