#include "adapter/lora_adapter.h"

#include <torch/torch.h>

#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/compensation.h"
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

}  // namespace

LoraAdapter::LoraAdapter(const VelocityField* field, const MethodOptions& options,
                         const StreamKey& session)
    : field_(field),
      options_(options),
      session_(session),
      phi_0_(InitialLora(field->lora_targets(), options.lora, options.rank, options.lora_init_std,
                         session)),
      adam_(InitialAdamState(Parameters(phi_0_))) {
  Publish(phi_0_);
}

absl::StatusOr<std::unique_ptr<LoraAdapter>> LoraAdapter::Create(const VelocityField* field,
                                                                 const MethodOptions& options,
                                                                 const StreamKey& session) {
  if (field->lora_targets().empty()) {
    return absl::FailedPreconditionError(
        "this policy has no layers that LoRA can adapt; use a method without adaptation, e.g. "
        "base");
  }
  if (options.rank < 1 || options.rank > 256) {
    return absl::InvalidArgumentError(
        absl::StrCat("rank is ", options.rank, "; it must be in 1..256"));
  }
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

void LoraAdapter::Publish(LoraWeights phi) {
  const double distance = LoraDistance(phi, phi_0_);
  auto snapshot = std::make_shared<const LoraWeights>(std::move(phi));
  absl::MutexLock lock(&mu_);
  published_ = std::move(snapshot);
  distance_ = distance;
  history_.push_back(published_);
  if (history_.size() > kHistory) history_.pop_front();
}

absl::StatusOr<UpdateReport> LoraAdapter::Update(
    uint64_t index, const std::vector<std::shared_ptr<const TrainingChunk>>& batch) {
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
    Publish(FromParameters(AdamStep(adam, Parameters(*current), gradients, adam_),
                           current->version + 1));
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("update ", index, ": ", error.what()));
  }
  report.applied = true;
  report.version = current->version + 1;
  report.distance = distance();
  return report;
}

LoraState LoraAdapter::Export() const { return {*snapshot(), phi_0_, adam_}; }

absl::Status LoraAdapter::Import(const LoraState& state) {
  const std::vector<torch::Tensor> expected = Parameters(phi_0_);
  RS_RETURN_IF_ERROR(SameShapes(expected, Parameters(state.phi), "LoRA"));
  RS_RETURN_IF_ERROR(SameShapes(expected, Parameters(state.phi_0), "anchor"));
  RS_RETURN_IF_ERROR(SameShapes(expected, state.adam.m, "first moment"));
  RS_RETURN_IF_ERROR(SameShapes(expected, state.adam.v, "second moment"));
  phi_0_ = state.phi_0;
  adam_ = state.adam;
  {
    absl::MutexLock lock(&mu_);
    history_.clear();
  }
  Publish(state.phi);
  return absl::OkStatus();
}

absl::Status LoraAdapter::Rollback(uint64_t version) {
  std::shared_ptr<const LoraWeights> found;
  if (version == 0) {
    found = std::make_shared<const LoraWeights>(phi_0_);
  } else {
    absl::MutexLock lock(&mu_);
    std::vector<uint64_t> held{0};
    for (const auto& weights : history_) {
      held.push_back(weights->version);
      if (weights->version == version) found = weights;
    }
    if (found == nullptr) {
      return absl::NotFoundError(
          absl::StrCat("version ", version, " is not held; held: ", absl::StrJoin(held, ", ")));
    }
    while (history_.back()->version != version) history_.pop_back();
    history_.pop_back();  // Publish adds it again
  }
  if (version == 0) {
    absl::MutexLock lock(&mu_);
    history_.clear();
  }
  adam_ = InitialAdamState(Parameters(phi_0_));
  Publish(*found);
  return absl::OkStatus();
}

}  // namespace robostress
