#include "robot_client/arm_model.h"

#include "absl/strings/str_cat.h"

namespace robostress {

absl::Status CheckWorkspace(const WorkspaceOptions& o, const std::string& section) {
  const auto invalid = [&](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(section, ".", parts...));
  };
  if (o.lower.size() != 3 || o.upper.size() != 3)
    return invalid("lower has ", o.lower.size(), " numbers and upper ", o.upper.size(),
                   "; both must have 3: x, y, z [m]");
  for (int i = 0; i < 3; ++i) {
    if (!(o.lower[i] < o.upper[i] && o.lower[i] >= -10 && o.upper[i] <= 10))
      return invalid("lower[", i, "] is ", o.lower[i], " and upper[", i, "] ", o.upper[i],
                     "; the first must be below the second, both within 10 m");
  }
  if (!(o.table_z >= -10 && o.table_z <= 10)) return invalid("table_z is ", o.table_z, " m");
  if (!(o.margin >= 0 && o.margin <= 0.5))
    return invalid("margin is ", o.margin, " m, must be 0 to 0.5");
  return absl::OkStatus();
}

const char* BoundName(ArmModel::Bound bound) {
  if (bound == ArmModel::kTable) return "the table";
  if (bound < ArmModel::kItself) return "the workspace box";
  return bound == ArmModel::kItself ? "the arm itself" : "nothing";
}

ArmModel::Bound CrossedBound(const ArmModel::Clearance& now, const ArmModel::Clearance& next) {
  constexpr double kRounding = 1e-9;
  for (int b = 0; b < ArmModel::kBounds; ++b) {
    // Written so that a NaN crosses.
    if (!(next[b] >= 0 || next[b] >= now[b] - kRounding)) return static_cast<ArmModel::Bound>(b);
  }
  return ArmModel::kBounds;
}

ArmModel::Bound BrokenBound(const ArmModel::Clearance& clearance) {
  constexpr double kRounding = 1e-6;  // of commands that go on pushing against a bound
  for (int b = 0; b < ArmModel::kBounds; ++b) {
    if (!(clearance[b] >= -kRounding)) return static_cast<ArmModel::Bound>(b);
  }
  return ArmModel::kBounds;
}

}  // namespace robostress
