#include "adapter/compensated_policy.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/measured_chunk.h"
#include "adapter/method_options.h"
#include "common/rollout/chunk_key.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status CheckWithoutWeights(const SessionSetting& setting, const MethodOptions& method) {
  if (method.adapts()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "method '", method.method,
        "' trains an adapter in the policy's weights (LoRA), and policy '", setting.policy,
        "' has none here; take one that corrects commands alone: gain, direct, ours_following"));
  }
  RS_RETURN_IF_ERROR(method.Check());
  if (!method.arm_model.empty()) {
    return absl::UnimplementedError(
        absl::StrCat("method '", method.method,
                     "' chooses commands by a model of the arm, arm_model=", method.arm_model,
                     ", which only `robostress worker` of the simulated Panda has; take one "
                     "that corrects commands alone: gain, direct, ours_following"));
  }
  return ActsInJointSpace(setting) ? method.CheckJointSpace(setting.robot) : absl::OkStatus();
}

CompensatedPolicy::CompensatedPolicy(PolicyEndpoint* policy, const SessionSetting& setting,
                                     const MethodOptions& method)
    : policy_(policy),
      method_(method),
      residual_(ResidualOf(setting, method)),
      correction_(method, residual_, NominalArmOf(setting, method)),
      running_(correction_) {}

absl::StatusOr<std::unique_ptr<CompensatedPolicy>> CompensatedPolicy::Create(
    PolicyEndpoint* policy, const SessionSetting& setting, const MethodOptions& method) {
  RS_RETURN_IF_ERROR(CheckWithoutWeights(setting, method));
  return std::unique_ptr<CompensatedPolicy>(new CompensatedPolicy(policy, setting, method));
}

absl::Status CompensatedPolicy::StartEpisode(const EpisodeKey& key) {
  episode_.reset();
  RS_RETURN_IF_ERROR(policy_->StartEpisode(key));
  episode_ = key;
  issued_.resize(0);
  correction_.StartEpisode();
  return absl::OkStatus();
}

absl::StatusOr<PredictedChunk> CompensatedPolicy::Predict(const Observation& observation,
                                                          int chunk) {
  return Corrected(policy_->Predict(observation, chunk));
}

absl::StatusOr<PredictedChunk> CompensatedPolicy::PredictAfter(const Observation& observation,
                                                               int chunk,
                                                               const RunningRows& running) {
  return Corrected(policy_->PredictAfter(observation, chunk, running));
}

absl::StatusOr<PredictedChunk> CompensatedPolicy::Corrected(
    absl::StatusOr<PredictedChunk> predicted) {
  if (!predicted.ok()) return predicted;
  CorrectCommands(*method_, policy_->spec(), correction_.Value(), *predicted);
  running_ = correction_;
  corrected_.clear();
  return predicted;
}

absl::StatusOr<Eigen::VectorXf> CompensatedPolicy::NextCommand(const PredictedChunk& predicted,
                                                               const ExecutedChunk& so_far) {
  if (!method_->every_step) return PolicyEndpoint::NextCommand(predicted, so_far);
  if (so_far.steps.empty()) {
    RS_ASSIGN_OR_RETURN(Eigen::VectorXf first, PolicyEndpoint::NextCommand(predicted, so_far));
    return Smoothed(std::move(first));
  }
  const auto row = static_cast<Eigen::Index>(so_far.steps.size());
  const ExecutedChunk newest = StepOf(so_far, so_far.steps.size() - 1);
  RS_ASSIGN_OR_RETURN(const MeasuredChunk measured,
                      MeasuredChunk::Create(newest, policy_->spec(), residual_));
  running_.Observe(measured.usable());
  PredictedChunk next;
  next.policy_actions = predicted.policy_actions.row(row);
  CorrectCommands(*method_, policy_->spec(), running_.Value(), next);
  return Smoothed(next.actions.row(0).transpose());
}

Eigen::VectorXf CompensatedPolicy::Smoothed(Eigen::VectorXf command) {
  corrected_.push_back(command);
  SmoothCommand(method_->smoothing, issued_, command);
  issued_ = command;
  return command;
}

absl::Status CompensatedPolicy::SendFeedback(ExecutedChunk executed) {
  RS_ASSIGN_OR_RETURN(const MeasuredChunk measured,
                      MeasuredChunk::Create(executed, policy_->spec(), residual_));
  const uint64_t sequence = executed.sequence;
  CommandCorrection after = correction_;
  if (episode_ == KeyOf(executed).episode && sequence > learned_) after.Observe(measured.usable());
  if (method_->target == TargetReference::kSent && method_->every_step) {
    for (size_t i = 0; i < executed.steps.size() && i < corrected_.size(); ++i)
      executed.steps[i].sent_command = corrected_[i];
  }
  RS_RETURN_IF_ERROR(policy_->SendFeedback(executed));
  correction_ = std::move(after);
  learned_ = std::max(learned_, sequence);
  return absl::OkStatus();
}

}  // namespace robostress
