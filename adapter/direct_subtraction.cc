#include "adapter/direct_subtraction.h"

#include "absl/algorithm/container.h"

namespace robostress {

void DirectSubtraction::Observe(const ExecutedChunk& chunk) {
  const auto masked = absl::c_count(chunk.masked, true);
  if (masked == static_cast<int64_t>(chunk.steps.size())) return;
  const Eigen::MatrixXd residual = ChunkResidual(chunk, residual_);  // masked rows are 0
  mean_ = masked == 0 ? Eigen::VectorXd(residual.colwise().mean().transpose())
                      : residual.colwise().sum().transpose() /
                            static_cast<double>(residual.rows() - masked);
}

}  // namespace robostress
