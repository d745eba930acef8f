#include "adapter/envelope.h"

#include "common/check.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status EnvelopeOptions::Check() const {
  RS_RETURN_IF_ERROR(CheckOption("envelope_share", share, 0, 1));
  return CheckOption("envelope_way", way, 0, 10);
}

Envelope::Envelope(const EnvelopeOptions& options, const ResidualOptions& residual,
                   const NominalArmOptions& arm)
    : options_(options), residual_(residual), arm_(arm) {
  residual_.scale = ResidualScale::kCommand;
}

void Envelope::StartEpisode() {
  arm_.Reset();
  nominal_.setZero();
  moved_.setZero();
}

void Envelope::Observe(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const NominalArm::Vector6 nominal = arm_.Step(step.sent_command.head<6>().cast<double>());
    nominal_ *= 1 - 1 / kMemory;
    moved_ *= 1 - 1 / kMemory;
    if (chunk.IsMasked(i)) continue;
    nominal_ += nominal.head<3>();
    moved_ += AchievedDelta(step.before, StateAfter(chunk, i), residual_).head<3>();
  }
}

bool Envelope::held() const {
  const double way = nominal_.norm();
  return way > options_.way && nominal_.dot(moved_) < options_.share * way * way;
}

Eigen::VectorXd Envelope::State() const {
  Eigen::VectorXd state(kStateSize);
  state << nominal_, moved_, arm_.state().goal, arm_.state().velocity;
  return state;
}

bool Envelope::Holds(const Eigen::VectorXd& state) const {
  return state.size() == kStateSize && (state.head<6>().array().abs() <= kFarthest).all() &&
         NominalArm::Holds({state.segment<6>(6), state.tail<6>()});
}

void Envelope::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == kStateSize);
  nominal_ = state.head<3>();
  moved_ = state.segment<3>(3);
  arm_.set_state({state.segment<6>(6), state.tail<6>()});
}

}  // namespace robostress
