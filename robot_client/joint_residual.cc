#include "robot_client/joint_residual.h"

#include <cmath>

#include "adapter/residual.h"

namespace robostress {

void JointResidual::Add(const ExecutedChunk& chunk, const ArmVector& chunk_start) {
  const Eigen::MatrixXd eta = ChunkResidual(chunk, {.space = ResidualSpace::kJoint});
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    if (chunk.IsMasked(i)) continue;
    eta_sq += eta.row(static_cast<Eigen::Index>(i)).squaredNorm();
    const auto joints = static_cast<int>(chunk.steps[i].before.q.size());
    for (int j = 0; j < joints; ++j) {
      const double d = static_cast<double>(chunk.steps[i].policy_command[j]) - chunk_start[j];
      displacement_sq += d * d;
    }
    ++steps;
  }
}

double JointResidual::value() const {
  return displacement_sq > 0 ? std::sqrt(eta_sq / displacement_sq) : 0;
}

}  // namespace robostress
