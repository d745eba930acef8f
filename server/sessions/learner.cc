#include "server/sessions/learner.h"

#include <spdlog/spdlog.h>
#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/compensation.h"
#include "adapter/method_options.h"
#include "adapter/pseudo_target.h"
#include "adapter/thrown_status.h"
#include "common/status_macros.h"
#include "server/sessions/state_rules.h"

namespace robostress {

namespace {

// Of a method that does not adapt, the defaults: nothing comes into its buffer.
LoraOptions LoraOf(const SessionSpec& spec) {
  const LoraOptions* lora = spec.method->Find<LoraOptions>();
  return lora == nullptr ? LoraOptions() : *lora;
}

}  // namespace

Learner::Learner(const SessionSpec* spec, std::shared_ptr<const FlowPolicy> policy,
                 std::shared_ptr<PrefixStore> prefixes, const GuardOptions& guard)
    : spec_(spec),
      policy_(std::move(policy)),
      prefixes_(std::move(prefixes)),
      guard_(guard),
      key_(StreamKey("session").With(SessionIdentity(*spec))),
      residual_(ResidualOf(*spec, *spec->method)),
      lora_(LoraOf(*spec)),
      buffer_(lora_.buffer_chunks),
      schedule_(lora_.buffer_chunks, lora_.update_interval),
      arm_(NominalArmOf(*spec, *spec->method)) {}

absl::StatusOr<std::unique_ptr<Learner>> Learner::Create(const SessionSpec* spec,
                                                         std::shared_ptr<const FlowPolicy> policy,
                                                         std::shared_ptr<PrefixStore> prefixes,
                                                         const GuardOptions& guard) {
  auto learner =
      std::unique_ptr<Learner>(new Learner(spec, std::move(policy), std::move(prefixes), guard));
  if (spec->method->adapts()) {
    RS_ASSIGN_OR_RETURN(learner->adapter_,
                        LoraAdapter::Create(learner->policy_.get(), learner->lora_, learner->key_));
  }
  return learner;
}

absl::Status Learner::RequireAdapter(const char* purpose) const {
  if (adapts()) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("method ", spec_->method->method, " has no adapter to ", purpose));
}

// --------------------------------------------------------------------------------------- feedback

absl::StatusOr<torch::Tensor> Learner::SentTargetOf(const ExecutedChunk& executed,
                                                    const Prediction& prediction) const {
  if (prediction.base.rows() != prediction.raw.size(0))
    return absl::FailedPreconditionError(
        absl::StrCat("target: sent needs the unadapted policy's chunk of ", prediction.raw.size(0),
                     " rows and has ", prediction.base.rows()));
  try {
    torch::NoGradGuard no_grad;
    torch::Tensor target =
        TargetChunk(prediction.raw, 0,
                    policy_->ToModel(SentTarget(executed, prediction.base), prediction.state));
    if (!torch::isfinite(target).all().item<bool>()) return prediction.raw;
    return target;
  } catch (const std::exception& error) {
    return ThrownStatus("target of sent commands", error);
  }
}

absl::StatusOr<BufferedChunk> Learner::MakeTraining(const MeasuredChunk& measured,
                                                    const Prediction& prediction,
                                                    NominalArm& arm) const {
  const ExecutedChunk& executed = measured.usable();
  BufferedChunk chunk;
  chunk.observation = prediction.observation;
  chunk.prefix = prediction.prefix;
  const EpisodeKey episode = KeyOf(executed).episode;
  if (executed.chunk == 0 || arm_episode_ != episode) {
    arm.Reset();
  }
  if (!lora_.use_residual) {  // eta = 0: the raw prediction itself, without a round trip
                              // through ToEnvironment
    chunk.target = prediction.raw;
    return chunk;
  }
  if (spec_->method->target == TargetReference::kSent) {
    RS_ASSIGN_OR_RETURN(chunk.target, SentTargetOf(executed, prediction));
    return chunk;
  }
  Eigen::MatrixXd other;  // against what is not the policy's own command
  if (spec_->method->target != TargetReference::kExecuted) {
    Eigen::MatrixXf base;
    if (prediction.base.rows() > 0) {
      base = prediction.base.middleRows(executed.first_step, executed.steps.size());
    }
    RS_ASSIGN_OR_RETURN(other,
                        ReferencedResidual(executed, spec_->method->target, residual_, base, &arm));
  }
  const Eigen::MatrixXd& residual =
      spec_->method->target == TargetReference::kExecuted ? measured.residual() : other;
  try {
    torch::NoGradGuard no_grad;
    chunk.target =
        TargetChunk(prediction.raw, executed.first_step,
                    policy_->ToModel(PseudoTarget(executed, residual), prediction.state));
    for (size_t i = 0; i < executed.masked.size(); ++i) {  // the prediction itself, in every bit
      const int64_t row = executed.first_step + static_cast<int64_t>(i);
      if (executed.masked[i]) chunk.target[row].copy_(prediction.raw[row]);
    }
    // A policy's transforms may pass float32 where a residual is large: nothing is learned of it.
    if (!torch::isfinite(chunk.target).all().item<bool>()) chunk.target = prediction.raw;
  } catch (const std::exception& error) {
    return ThrownStatus("pseudo-target", error);
  }
  return chunk;
}

absl::StatusOr<Learner::Lesson> Learner::Prepare(const MeasuredChunk& measured,
                                                 const Prediction& prediction) const {
  Lesson lesson{.training = std::nullopt, .arm = arm_, .episode = prediction.key.episode};
  if (adapts()) {
    RS_ASSIGN_OR_RETURN(lesson.training, MakeTraining(measured, prediction, lesson.arm));
  }
  return lesson;
}

std::optional<Learner::Update> Learner::Learn(Lesson lesson, uint64_t sequence) {
  std::optional<Update> due;
  if (lesson.training) {
    arm_ = lesson.arm;
    arm_episode_ = lesson.episode;
    buffer_.Add(*std::move(lesson.training));
    if (schedule_.Add()) due = MakeUpdate(sequence);
  }
  if (boundaries_.erase(sequence) > 0) Clear();
  return due;
}

void Learner::Clear() {
  buffer_.Clear();
  schedule_.Clear();
}

void Learner::AddBoundary(uint64_t last_sequence, uint64_t in) {
  if (in >= last_sequence) {
    Clear();
  } else {
    boundaries_.insert(last_sequence);
  }
}

absl::Status Learner::CheckBoundary(uint64_t last_sequence, uint64_t in) const {
  RS_RETURN_IF_ERROR(StateRules::CheckCount("last_feedback_sequence", last_sequence));
  if (last_sequence <= in || boundaries_.size() < StateRules::kMaxBoundaries)
    return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("the last feedback of ", boundaries_.size(),
                                                    " tasks is still missing; ", in,
                                                    " is in: send what comes after it"));
}

// ---------------------------------------------------------------------------------------- updates

Learner::Update Learner::MakeUpdate(uint64_t sequence) {
  const uint64_t index = triggers_++;
  Update update{index, sequence, {}, {}};
  const StreamKey key = key_.With("update").With(static_cast<int64_t>(index));
  // The batch, and for the guard what follows it in the same permutation.
  const int size = lora_.batch;
  const int held_out = guard_.enabled ? std::min(guard_.chunks, buffer_.size() - size) : 0;
  for (const int i : SampleWithoutReplacement(key.With("batch"), buffer_.size(), size + held_out)) {
    auto& into = static_cast<int>(update.batch.size()) < size ? update.batch : update.held_out;
    into.push_back(buffer_[i]);
  }
  ++pending_;
  return update;
}

absl::StatusOr<std::vector<std::shared_ptr<const TrainingChunk>>> Learner::WithPrefixes(
    const std::vector<BufferedChunk>& chunks) const {
  std::vector<std::shared_ptr<const TrainingChunk>> result;
  for (const BufferedChunk& chunk : chunks) {
    RS_ASSIGN_OR_RETURN(PolicyContext context, prefixes_->Get(*chunk.prefix));
    result.push_back(
        std::make_shared<const TrainingChunk>(TrainingChunk{std::move(context), chunk.target}));
  }
  return result;
}

absl::StatusOr<UpdateReport> Learner::Compute(const Update& update) {
  RS_ASSIGN_OR_RETURN(const auto chunks, WithPrefixes(update.batch));
  UpdateContext context{update.sequence, guard_, {}};
  RS_ASSIGN_OR_RETURN(context.held_out, WithPrefixes(update.held_out));
  return adapter_->Update(update.index, chunks, context);
}

absl::Status Learner::Finish(const Update& update, const absl::StatusOr<UpdateReport>& report) {
  --pending_;
  if (!report.ok()) {
    spdlog::error("session {}: {}", SessionIdentity(*spec_), report.status().ToString());
    return report.status();
  }
  if (std::isfinite(report->loss)) last_loss_ = report->loss;
  if (report->applied) return absl::OkStatus();
  if (report->verdict) {
    ++counters_.guarded;
    spdlog::warn("session {}: update {} refused by the guard, loss {} after {}, distance {}",
                 SessionIdentity(*spec_), update.index, report->verdict->candidate_loss,
                 report->verdict->published_loss, report->verdict->candidate_distance);
    return absl::OkStatus();
  }
  ++counters_.refused;
  spdlog::warn("session {}: update {} refused, loss {} gradient norm {}", SessionIdentity(*spec_),
               update.index, report->loss, report->gradient_norm);
  return absl::OkStatus();
}

}  // namespace robostress
