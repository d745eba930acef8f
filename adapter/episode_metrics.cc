#include "adapter/episode_metrics.h"

#include <cmath>

namespace robostress {
namespace {

double Ratio(double numerator_sq, double denominator_sq) {
  return denominator_sq > 0 ? std::sqrt(numerator_sq / denominator_sq) : 0.0;
}

}  // namespace

EpisodeMetrics::EpisodeMetrics(const ResidualOptions& options)
    : command_(options), tracking_(options) {
  command_.scale = ResidualScale::kCommand;
  tracking_.scale = ResidualScale::kTracking;
}

void EpisodeMetrics::Add(const ExecutedChunk& chunk) {
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    if (chunk.IsMasked(i)) continue;
    const ExecutedStep& step = chunk.steps[i];
    const RobotState& after = StateAfter(chunk, i);
    ++steps_;
    eta_sq_ += StepResidual(step.before, after, step.policy_command, command_).squaredNorm();
    tracking_eta_sq_ +=
        StepResidual(step.before, after, step.policy_command, tracking_).squaredNorm();
    a_sq_ += ReferenceCommand(step.policy_command, command_).squaredNorm();
    if (step.base_command.size() == step.policy_command.size()) {
      intent_eta_sq_ += StepResidual(step.before, after, step.base_command, command_).squaredNorm();
      intent_tracking_eta_sq_ +=
          StepResidual(step.before, after, step.base_command, tracking_).squaredNorm();
      intent_a_sq_ += ReferenceCommand(step.base_command, command_).squaredNorm();
    } else {
      has_intent_ = false;
    }
    const Eigen::Index arm = step.policy_command.size() - 1;
    entries_ += arm;
    abs_sum_ += step.policy_command.head(arm).cast<double>().cwiseAbs().sum();
    clipped_ += (step.sent_command.head(arm).array().abs() > 1.0f).count();
  }
}

double EpisodeMetrics::residual() const { return Ratio(eta_sq_, a_sq_); }
double EpisodeMetrics::residual_tracking() const { return Ratio(tracking_eta_sq_, a_sq_); }

std::optional<double> EpisodeMetrics::intent() const {
  if (!has_intent_) return std::nullopt;
  return Ratio(intent_eta_sq_, intent_a_sq_);
}

std::optional<double> EpisodeMetrics::intent_tracking() const {
  if (!has_intent_) return std::nullopt;
  return Ratio(intent_tracking_eta_sq_, intent_a_sq_);
}

double EpisodeMetrics::mean_abs_action() const { return entries_ > 0 ? abs_sum_ / entries_ : 0.0; }

double EpisodeMetrics::clipped_share() const {
  return entries_ > 0 ? static_cast<double>(clipped_) / entries_ : 0.0;
}

}  // namespace robostress
