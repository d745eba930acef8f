#include "adapter/command_bounds.h"

#include <algorithm>
#include <cmath>

namespace robostress {

void BoundCommands(const PolicySpec& spec, const Eigen::MatrixXf& own, Eigen::MatrixXf& commands) {
  for (Eigen::Index column = 0; column < commands.cols(); ++column) {
    float low = -kWidestCommand, high = kWidestCommand;
    if (!spec.action_low.empty()) {
      const auto j = static_cast<size_t>(column);
      const float span = spec.action_high[j] - spec.action_low[j];
      low = std::max(low, spec.action_low[j] - span);
      high = std::min(high, spec.action_high[j] + span);
    }
    for (Eigen::Index row = 0; row < commands.rows(); ++row) {
      const float wish = own(row, column);
      float& command = commands(row, column);
      command = std::isnan(command)
                    ? wish
                    : std::clamp(command, std::min(low, wish), std::max(high, wish));
    }
  }
}

}  // namespace robostress
