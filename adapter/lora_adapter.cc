#include "adapter/lora_adapter.h"

#include <torch/autograd.h>
#include <torch/types.h>

#include <cmath>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/compensation.h"
#include "adapter/thrown_status.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

absl::Status SameShapes(const std::vector<torch::Tensor>& expected,
                        const std::vector<torch::Tensor>& got, const char* what) {
  if (expected.size() != got.size()) {
    return absl::InvalidArgumentError(absl::StrCat(
        what, " has ", got.size(), " tensors; this policy's adapter has ", expected.size()));
  }
  for (size_t i = 0; i < expected.size(); ++i) {
    if (expected[i].sizes() != got[i].sizes() || expected[i].dtype() != got[i].dtype()) {
      return absl::InvalidArgumentError(
          absl::StrCat(what, " tensor ", i, " has shape [", absl::StrJoin(got[i].sizes(), ", "),
                       "]; this policy's adapter has [", absl::StrJoin(expected[i].sizes(), ", "),
                       "] in float32; use an adapter of the same model, kind (lora) and rank"));
    }
  }
  return absl::OkStatus();
}

bool AllFinite(const std::vector<torch::Tensor>& tensors) {
  return absl::c_all_of(tensors, [](const torch::Tensor& tensor) {
    return torch::isfinite(tensor).all().item<bool>();
  });
}

}  // namespace

LoraAdapter::LoraAdapter(const VelocityField* field, const LoraOptions& options,
                         const StreamKey& session)
    : field_(field),
      options_(options),
      session_(session),
      phi_0_(InitialLora(field->lora_targets(), options.kind, options.rank, options.init_std,
                         session)),
      adam_(InitialAdamState(Parameters(phi_0_))) {
  Publish(phi_0_, 0, 0);
}

absl::StatusOr<std::unique_ptr<LoraAdapter>> LoraAdapter::Create(const VelocityField* field,
                                                                 const LoraOptions& options,
                                                                 const StreamKey& session) {
  if (field->lora_targets().empty()) {
    return absl::FailedPreconditionError(
        "this policy has no layers that LoRA can adapt; use a method without adaptation, e.g. "
        "base");
  }
  RS_RETURN_IF_ERROR(options.Check());
  return std::unique_ptr<LoraAdapter>(new LoraAdapter(field, options, session));
}

std::shared_ptr<const LoraWeights> LoraAdapter::snapshot() const {
  absl::MutexLock lock(&mu_);
  return published_;
}

double LoraAdapter::distance() const {
  absl::MutexLock lock(&mu_);
  return distance_;
}

void LoraAdapter::Publish(LoraWeights phi, double loss, uint64_t feedback_sequence) {
  const double distance = LoraDistance(phi, phi_0_);
  auto snapshot = std::make_shared<const LoraWeights>(std::move(phi));
  absl::MutexLock lock(&mu_);
  Publish({std::move(snapshot), distance, loss, feedback_sequence, false});
}

void LoraAdapter::Publish(PublishedVersion version) {
  published_ = version.weights;
  distance_ = version.distance;
  history_.push_back(std::move(version));
  TrimHistory();
}

void LoraAdapter::TrimHistory() {
  const auto pinned = [](const PublishedVersion& v) { return v.pinned; };
  while (history_.size() - absl::c_count_if(history_, pinned) > kHistory)
    history_.erase(absl::c_find_if_not(history_, pinned));
}

absl::StatusOr<UpdateReport> LoraAdapter::Update(
    uint64_t index, const std::vector<std::shared_ptr<const TrainingChunk>>& batch,
    const UpdateContext& context) {
  const std::shared_ptr<const LoraWeights> current = snapshot();
  UpdateReport report;
  report.version = current->version;
  report.distance = distance();
  try {
    std::vector<const PolicyContext*> contexts;
    std::vector<torch::Tensor> targets;
    for (const auto& chunk : batch) {
      contexts.push_back(&chunk->context);
      targets.push_back(chunk->target);
    }
    std::vector<torch::Tensor> leaves;
    for (const torch::Tensor& parameter : Parameters(*current)) {
      leaves.push_back(parameter.detach().clone().requires_grad_(true));
    }
    const FlowDraw draw = DrawFlow(session_, index, field_->horizon(), field_->model_action_dim());
    const torch::Tensor loss =
        CompensationLoss(*field_, StackContexts(contexts), torch::stack(targets), draw,
                         FromParameters(leaves, current->version), phi_0_, options_.anchor_weight);
    std::vector<torch::Tensor> gradients = torch::autograd::grad({loss}, leaves);
    report.loss = loss.item<double>();
    report.gradient_norm = ClipGlobalNorm(gradients, options_.clip_norm);
    if (!std::isfinite(report.loss) || !std::isfinite(report.gradient_norm)) return report;

    const AdamOptions adam{options_.learning_rate, options_.beta1, options_.beta2,
                           options_.adam_epsilon};
    AdamState next = adam_;
    LoraWeights candidate =
        FromParameters(AdamStep(adam, Parameters(*current), gradients, next), current->version + 1);
    if (context.guard.enabled) {
      report.verdict = JudgeUpdate(context.guard, *field_, session_, context.held_out, *current,
                                   candidate, phi_0_);
      if (!report.verdict->accepted) return report;
    }
    // A gradient may be finite and its square in Adam's second moment not.
    if (!AllFinite(Parameters(candidate)) || !AllFinite(next.m) || !AllFinite(next.v))
      return report;
    adam_ = std::move(next);
    Publish(std::move(candidate), report.loss, context.feedback_sequence);
  } catch (const std::exception& error) {
    return ThrownStatus(absl::StrCat("update ", index), error);
  }
  report.applied = true;
  report.version = current->version + 1;
  report.distance = distance();
  return report;
}

LoraState LoraAdapter::Export() const { return {*snapshot(), phi_0_, adam_}; }

absl::Status LoraAdapter::CheckShapes(const LoraState& state) const {
  const std::vector<torch::Tensor> expected = Parameters(phi_0_);
  RS_RETURN_IF_ERROR(SameShapes(expected, Parameters(state.phi), "LoRA"));
  RS_RETURN_IF_ERROR(SameShapes(expected, Parameters(state.phi_0), "anchor"));
  RS_RETURN_IF_ERROR(SameShapes(expected, state.adam.m, "first moment"));
  return SameShapes(expected, state.adam.v, "second moment");
}

absl::Status LoraAdapter::Import(const LoraState& state) {
  RS_RETURN_IF_ERROR(CheckShapes(state));
  adam_ = state.adam;
  PublishedVersion imported{std::make_shared<const LoraWeights>(state.phi)};
  imported.distance = LoraDistance(state.phi, state.phi_0);
  absl::MutexLock lock(&mu_);
  phi_0_ = state.phi_0;
  history_.clear();
  Publish(std::move(imported));
  return absl::OkStatus();
}

absl::Status LoraAdapter::CheckRollback(uint64_t version) const {
  absl::MutexLock lock(&mu_);
  std::vector<uint64_t> held{0};
  for (const PublishedVersion& candidate : history_) {
    const uint64_t other = candidate.weights->version;
    if (other != 0) held.push_back(other);
    if (other > version && candidate.pinned) {
      return absl::FailedPreconditionError(
          absl::StrCat("version ", other, " is pinned and would be forgotten by going back to ",
                       version, "; take its pin away first"));
    }
  }
  if (absl::c_linear_search(held, version)) return absl::OkStatus();
  return absl::NotFoundError(
      absl::StrCat("version ", version, " is not held; held: ", absl::StrJoin(held, ", ")));
}

absl::Status LoraAdapter::Rollback(uint64_t version) {
  RS_RETURN_IF_ERROR(CheckRollback(version));
  PublishedVersion found{std::make_shared<const LoraWeights>(phi_0_)};
  adam_ = InitialAdamState(Parameters(phi_0_));
  absl::MutexLock lock(&mu_);
  while (!history_.empty() && history_.back().weights->version >= version) {
    if (version != 0 && history_.back().weights->version == version) found = history_.back();
    history_.pop_back();
  }
  Publish(std::move(found));
  return absl::OkStatus();
}

std::vector<PublishedVersion> LoraAdapter::Versions() const {
  absl::MutexLock lock(&mu_);
  std::vector<PublishedVersion> result(history_.begin(), history_.end());
  if (result.front().weights->version != 0)
    result.insert(result.begin(), {std::make_shared<const LoraWeights>(phi_0_)});
  return result;
}

absl::Status LoraAdapter::CheckPin(uint64_t version, bool pinned) const {
  absl::MutexLock lock(&mu_);
  size_t others = 0;
  bool found = version == 0;  // phi_0 is always held
  for (const PublishedVersion& held : history_) {
    if (held.weights->version == version) {
      found = true;
    } else if (held.pinned) {
      ++others;
    }
  }
  if (!found) {
    return absl::NotFoundError(
        absl::StrCat("version ", version, " is not held; list the versions for those that are"));
  }
  if (pinned && version != 0 && others >= kMaxPinned) {
    return absl::ResourceExhaustedError(
        absl::StrCat(others, " versions are pinned, which is the limit; take a pin away first"));
  }
  return absl::OkStatus();
}

absl::Status LoraAdapter::Pin(uint64_t version, bool pinned) {
  RS_RETURN_IF_ERROR(CheckPin(version, pinned));
  absl::MutexLock lock(&mu_);
  for (PublishedVersion& held : history_) {
    if (held.weights->version == version && version != 0) held.pinned = pinned;
  }
  return absl::OkStatus();
}

absl::Status LoraAdapter::RestoreVersions(std::vector<PublishedVersion> versions) {
  const std::vector<torch::Tensor> expected = Parameters(phi_0_);
  if (versions.size() > kHistory + kMaxPinned + 1) {
    return absl::InvalidArgumentError(absl::StrCat(versions.size(), " versions are held, at most ",
                                                   kHistory + kMaxPinned + 1, " can be"));
  }
  size_t pinned = 0;
  for (size_t i = 0; i < versions.size(); ++i) {
    const PublishedVersion& held = versions[i];
    RS_RETURN_IF_ERROR(SameShapes(expected, Parameters(*held.weights), "version"));
    const uint64_t version = held.weights->version;
    if (i > 0 && version <= versions[i - 1].weights->version) {
      return absl::InvalidArgumentError(
          absl::StrCat("version ", version, " is held after ", versions[i - 1].weights->version));
    }
    pinned += held.pinned;
    if (pinned > kMaxPinned || (held.pinned && version == 0)) {
      return absl::InvalidArgumentError(absl::StrCat("version ", version,
                                                     " is pinned; phi_0 needs no pin and at most ",
                                                     kMaxPinned, " others have one"));
    }
    if (!(std::isfinite(held.loss) && held.distance >= 0 && std::isfinite(held.distance))) {
      return absl::InvalidArgumentError(absl::StrCat("version ", version, " has loss ", held.loss,
                                                     " and distance ", held.distance,
                                                     "; both must be finite"));
    }
  }
  absl::MutexLock lock(&mu_);
  if (versions.empty() || versions.back().weights->version != published_->version) {
    return absl::InvalidArgumentError(
        absl::StrCat("the last version held is not the published one, ", published_->version));
  }
  versions.back().weights = published_;
  history_.assign(versions.begin(), versions.end());
  TrimHistory();
  return absl::OkStatus();
}

}  // namespace robostress
