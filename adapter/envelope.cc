#include "adapter/envelope.h"

#include <utility>

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
  short_ = long_ = {};
}

void Envelope::Observe(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    Eigen::Vector3d nominal =
        arm_.Step(step.sent_command.head<6>().cast<double>(), step.before).head<3>();
    Eigen::Vector3d moved = AchievedDelta(step.before, StateAfter(chunk, i), residual_).head<3>();
    if (chunk.IsMasked(i)) nominal = moved = Eigen::Vector3d::Zero();
    for (const auto& [recent, memory] : {std::pair{&short_, kShort}, std::pair{&long_, kLong}}) {
      recent->nominal = (1 - 1 / memory) * recent->nominal + nominal;
      recent->moved = (1 - 1 / memory) * recent->moved + moved;
    }
  }
}

bool Envelope::Held(const Way& recent, double way) const {
  const double length = recent.nominal.norm();
  return length > way && recent.nominal.dot(recent.moved) < options_.share * length * length;
}

Eigen::VectorXd Envelope::State() const {
  Eigen::VectorXd state(kStateSize);
  state << short_.nominal, short_.moved, long_.nominal, long_.moved, arm_.state().goal,
      arm_.state().velocity;
  return state;
}

bool Envelope::Holds(const Eigen::VectorXd& state) const {
  return state.size() == kStateSize && (state.head<12>().array().abs() <= kFarthest).all() &&
         NominalArm::Holds({state.segment<6>(12), state.tail<6>()});
}

void Envelope::SetState(const Eigen::VectorXd& state) {
  RS_CHECK(state.size() == kStateSize);
  short_ = {state.head<3>(), state.segment<3>(3)};
  long_ = {state.segment<3>(6), state.segment<3>(9)};
  arm_.set_state({state.segment<6>(12), state.tail<6>()});
}

}  // namespace robostress
