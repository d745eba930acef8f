#include "adapter/pseudo_target.h"

#include "absl/strings/str_cat.h"
#include "common/check.h"

namespace robostress {

absl::StatusOr<Eigen::MatrixXd> ReferencedResidual(const ExecutedChunk& chunk,
                                                   TargetReference reference,
                                                   const ResidualOptions& options,
                                                   const Eigen::MatrixXf& base, NominalArm* arm) {
  if (reference == TargetReference::kExecuted) return ChunkResidual(chunk, options);

  const auto steps = static_cast<Eigen::Index>(chunk.steps.size());
  if (NeedsBase(reference) && base.rows() != steps) {
    return absl::FailedPreconditionError(
        absl::StrCat("target: intent and nominal_intent need the unadapted policy's actions for ",
                     steps, " executed steps and have ", base.rows(), "; set track_intent"));
  }
  if (reference == TargetReference::kIntent) {
    Eigen::MatrixXd residual(steps, base.cols());
    for (Eigen::Index i = 0; i < steps; ++i) {
      if (chunk.IsMasked(i)) {
        residual.row(i).setZero();
        continue;
      }
      residual.row(i) =
          StepResidual(chunk.steps[i].before, StateAfter(chunk, i), base.row(i), options);
    }
    return residual;
  }

  if (options.space != ResidualSpace::kEndEffector || arm == nullptr) {
    return absl::InvalidArgumentError(
        "targets nominal and nominal_intent model an end-effector controller; use target executed "
        "or intent in joint space");
  }
  Eigen::MatrixXd residual = Eigen::MatrixXd::Zero(steps, chunk.steps[0].policy_command.size());
  const double divisor = options.scale == ResidualScale::kTracking ? options.tracking_gain : 1.0;
  for (Eigen::Index i = 0; i < steps; ++i) {
    const NominalArm::Vector6 command =
        reference == TargetReference::kNominalIntent
            ? base.row(i).head<6>().transpose().cast<double>().eval()
            : chunk.steps[i].sent_command.head<6>().cast<double>().eval();
    const NominalArm::Vector6 nominal = arm->Step(command, chunk.steps[i].before);
    if (chunk.IsMasked(i)) continue;
    residual.row(i).head<6>() =
        (AchievedDelta(chunk.steps[i].before, StateAfter(chunk, i), options) - nominal / divisor)
            .transpose();
  }
  return residual;
}

Eigen::MatrixXf SentTarget(const ExecutedChunk& chunk, const Eigen::MatrixXf& base) {
  const auto steps = static_cast<Eigen::Index>(chunk.steps.size());
  RS_CHECK(chunk.first_step >= 0 && chunk.first_step + steps <= base.rows());
  Eigen::MatrixXf target = base;
  const Eigen::Index arm = base.cols() - 1;
  for (Eigen::Index i = 0; i < steps; ++i) {
    if (chunk.IsMasked(i)) continue;
    target.row(chunk.first_step + i).head(arm) = chunk.steps[i].sent_command.head(arm).transpose();
  }
  return target;
}

Eigen::MatrixXf PseudoTarget(const ExecutedChunk& chunk, const Eigen::MatrixXd& residual) {
  RS_CHECK(residual.rows() == static_cast<Eigen::Index>(chunk.steps.size()));
  Eigen::MatrixXf target(residual.rows(), residual.cols());
  for (Eigen::Index i = 0; i < target.rows(); ++i) {
    const Eigen::VectorXf& command = chunk.steps[i].policy_command;
    target.row(i) =
        (command.cast<double>() - residual.row(i).transpose()).cast<float>().transpose();
    target(i, target.cols() - 1) = command[command.size() - 1];
  }
  return target;
}

}  // namespace robostress
