#include "adapter/residual_calibrator.h"

#include <Eigen/Cholesky>

#include "common/check.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr double kReach = 0.5;  // [m]

}  // namespace

absl::Status CalibratorOptions::Check() const {
  RS_RETURN_IF_ERROR(CheckOption("calibrator_memory", memory, 1, 1e9));
  RS_RETURN_IF_ERROR(CheckOption("calibrator_ridge", ridge, 1e-6, 1e6));
  return CheckOption("calibrator_limit", limit, 0, 10);
}

ResidualCalibrator::ResidualCalibrator(const CalibratorOptions& options,
                                       const ResidualOptions& residual,
                                       const NominalArmOptions& arm)
    : options_(options), residual_(residual), arm_(arm), A_(options.ridge * Moments::Identity()) {
  residual_.scale = ResidualScale::kCommand;
}

void ResidualCalibrator::StartEpisode() {
  arm_.Reset();
  phi_.setZero();
}

void ResidualCalibrator::Observe(const ExecutedChunk& chunk) {
  const double kept = 1 - 1 / options_.memory;
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const Vector6 sent = step.sent_command.head<6>().cast<double>();
    const Vector6 nominal = arm_.Step(sent, step.before);
    if (chunk.IsMasked(i)) {
      phi_.setZero();
      continue;
    }
    const Vector6 motion = AchievedDelta(step.before, StateAfter(chunk, i), residual_).head<6>();
    const Eigen::Vector3d beyond = (motion - nominal).head<kAxes>() / residual_.tracking_gain;
    A_ = kept * A_ + phi_ * phi_.transpose();
    A_.diagonal().array() += options_.ridge / options_.memory;
    B_ = kept * B_ + phi_ * beyond.transpose();
    phi_ << 1, StateAfter(chunk, i).tool.p_base_tool / kReach, sent.cwiseMax(-1.0).cwiseMin(1.0),
        motion / residual_.tracking_gain;
  }
}

Eigen::VectorXd ResidualCalibrator::correction() const {
  Eigen::VectorXd correction = Eigen::VectorXd::Zero(6);
  const Features weights = A_.llt().solve(phi_);
  correction.head<kAxes>() =
      (-B_.transpose() * weights).cwiseMax(-options_.limit).cwiseMin(options_.limit);
  return correction;
}

Eigen::VectorXd ResidualCalibrator::State() const {
  Eigen::VectorXd state(kStateSize);
  state << A_.reshaped(), B_.reshaped(), phi_, arm_.state().goal, arm_.state().velocity;
  return state;
}

bool ResidualCalibrator::Holds(const Eigen::VectorXd& state) const {
  if (state.size() != kStateSize || !(state.array().abs() <= kLargest).all()) return false;
  const Moments A = state.head<kFeatures * kFeatures>().reshaped(kFeatures, kFeatures);
  return A.isApprox(A.transpose()) && A.llt().info() == Eigen::Success &&
         NominalArm::Holds({state.segment<6>(kStateSize - 12), state.tail<6>()});
}

void ResidualCalibrator::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == kStateSize);
  constexpr int kMoments = kFeatures * kFeatures, kAnswers = kFeatures * kAxes;
  A_ = state.head<kMoments>().reshaped(kFeatures, kFeatures);
  B_ = state.segment<kAnswers>(kMoments).reshaped(kFeatures, kAxes);
  phi_ = state.segment<kFeatures>(kMoments + kAnswers);
  arm_.set_state({state.segment<6>(kStateSize - 12), state.tail<6>()});
}

}  // namespace robostress
