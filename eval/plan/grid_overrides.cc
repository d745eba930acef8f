#include "eval/plan/grid_overrides.h"

#include "absl/strings/match.h"
#include "adapter/methods.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr absl::string_view kMethod = "method.", kRemote = "remote.";

}  // namespace

GridOverrides PartOverrides(const SweepGrid& grid) {
  GridOverrides parts;
  for (const std::string& assignment : grid.overrides) {
    if (absl::StartsWith(assignment, kMethod)) {
      parts.method.push_back(assignment.substr(kMethod.size()));
    } else if (absl::StartsWith(assignment, kRemote)) {
      parts.remote.push_back(assignment.substr(kRemote.size()));
    } else {
      parts.others.push_back(assignment);
    }
  }
  return parts;
}

absl::StatusOr<MethodOptions> MethodOf(const SweepGrid& grid, const std::string& name) {
  RS_ASSIGN_OR_RETURN(MethodOptions method,
                      MakeMethodOf(grid.methods, name, PartOverrides(grid).method));
  RS_RETURN_IF_ERROR(method.Check());
  return method;
}

}  // namespace robostress
