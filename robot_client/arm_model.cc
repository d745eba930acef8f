#include "robot_client/arm_model.h"

namespace robostress {

const char* BoundName(ArmModel::Bound bound) {
  switch (bound) {
    case ArmModel::kTable:
      return "the table";
    case ArmModel::kBox:
      return "the workspace box";
    case ArmModel::kItself:
      return "the arm itself";
    case ArmModel::kBounds:
      break;
  }
  return "nothing";
}

ArmModel::Bound CrossedBound(const ArmModel::Clearance& now, const ArmModel::Clearance& next) {
  constexpr double kRounding = 1e-9;
  for (int b = 0; b < ArmModel::kBounds; ++b) {
    // Written so that a NaN crosses.
    if (!(next[b] >= 0 || next[b] >= now[b] - kRounding)) return static_cast<ArmModel::Bound>(b);
  }
  return ArmModel::kBounds;
}

}  // namespace robostress
