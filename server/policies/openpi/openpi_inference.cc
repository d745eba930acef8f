#include "server/policies/openpi/openpi_inference.h"

#include <torch/types.h>

#include <limits>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/synchronization/mutex.h"
#include "adapter/lora.h"
#include "adapter/thrown_status.h"
#include "common/status_macros.h"
#include "server/policies/openpi/openpi_lora.h"
#include "server/policies/openpi/step_graph.h"

namespace robostress::openpi {
namespace {

constexpr int64_t kJoinLimitBytes = 4 << 20;  // see Projection::Join
constexpr int64_t kGraphSlots = 64;           // prefixes of a graph are multiples of this
constexpr size_t kMaxGraphs = 16;

std::string SizesText(const torch::Tensor& tensor) {
  return tensor.defined() ? absl::StrCat("[", absl::StrJoin(tensor.sizes(), ", "), "]") : "absent";
}

absl::Status CheckSizes(const std::string& what, const torch::Tensor& tensor,
                        torch::IntArrayRef sizes) {
  if (tensor.defined() && tensor.sizes() == sizes) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(what, " is ", SizesText(tensor), ", must be [",
                                                 absl::StrJoin(sizes, ", "), "]"));
}

absl::Status CheckInputs(const OpenpiConfig& c, const ModelInputs& in) {
  if (!in.tokens.defined() || in.tokens.dim() != 2 || in.tokens.size(0) == 0 ||
      in.tokens.scalar_type() != torch::kInt64) {
    return absl::InvalidArgumentError(
        absl::StrCat("tokens are ", SizesText(in.tokens), ", must be [batch, n] int64"));
  }
  const int64_t batch = in.tokens.size(0);
  RS_RETURN_IF_ERROR(CheckSizes("token_mask", in.token_mask, in.tokens.sizes()));
  if (in.tokens.numel() > 0) {
    const int64_t low = in.tokens.min().item<int64_t>(), high = in.tokens.max().item<int64_t>();
    if (low < 0 || high >= c.vocab) {
      return absl::InvalidArgumentError(
          absl::StrCat("tokens hold ", low < 0 ? low : high, ", must be in [0, ", c.vocab, ")"));
    }
  }
  if (in.images.size() != in.image_masks.size()) {
    return absl::InvalidArgumentError(absl::StrCat(in.images.size(), " images with ",
                                                   in.image_masks.size(), " masks, must be equal"));
  }
  torch::Tensor valid = in.token_mask.sum(1);
  for (size_t i = 0; i < in.images.size(); ++i) {
    RS_RETURN_IF_ERROR(
        CheckSizes(absl::StrCat("image ", i), in.images[i], {batch, 3, c.image, c.image}));
    RS_RETURN_IF_ERROR(CheckSizes(absl::StrCat("image mask ", i), in.image_masks[i], {batch}));
    valid = valid + in.image_masks[i].to(torch::kInt64);
  }
  if (valid.min().item<int64_t>() == 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("row ", valid.argmin().item<int64_t>(),
                     " has neither a camera nor a prompt token; give one that its mask keeps"));
  }
  return c.pi05 ? absl::OkStatus() : CheckSizes("state", in.state, {batch, c.action_dim});
}

absl::Status CheckLora(const std::vector<LoraTarget>& targets, const LoraWeights& lora) {
  if (lora.A.size() != targets.size() || lora.B.size() != targets.size()) {
    return absl::InvalidArgumentError(absl::StrCat("the adapter has ", lora.A.size(), " A and ",
                                                   lora.B.size(), " B, must have ", targets.size(),
                                                   " of each"));
  }
  for (size_t i = 0; i < targets.size(); ++i) {
    // Both kinds of factors begin with the heads where there are three dimensions.
    const torch::Tensor &A = lora.A[i], &B = lora.B[i];
    const bool per_head = A.defined() && A.dim() == 3;
    const int64_t rank = A.defined() && A.dim() >= 2 ? A.size(-2) : 1;
    const LoraShape shape =
        LoraShapeOf(targets[i], per_head ? LoraKind::kPerHead : LoraKind::kPerMatrix, rank);
    RS_RETURN_IF_ERROR(CheckSizes(absl::StrCat("A of ", targets[i].name), A, shape.A));
    RS_RETURN_IF_ERROR(CheckSizes(absl::StrCat("B of ", targets[i].name), B, shape.B));
  }
  return absl::OkStatus();
}

absl::Status CheckContext(const OpenpiConfig& c, const PolicyContext& context,
                          const torch::Tensor& noise) {
  if (!noise.defined() || noise.dim() != 3 || noise.size(0) == 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "noise is ", SizesText(noise), ", must be [batch, ", c.horizon, ", ", c.action_dim, "]"));
  }
  const int64_t batch = noise.size(0);
  RS_RETURN_IF_ERROR(CheckSizes("noise", noise, {batch, c.horizon, c.action_dim}));
  const int64_t prefix = context.prefix_mask.defined() ? context.prefix_mask.size(-1) : 0;
  RS_RETURN_IF_ERROR(CheckSizes("the context's prefix mask", context.prefix_mask, {batch, prefix}));
  if (!c.pi05)
    RS_RETURN_IF_ERROR(CheckSizes("the context's state", context.state, {batch, c.action_dim}));
  if (context.keys.size() != static_cast<size_t>(c.depth) ||
      context.values.size() != context.keys.size()) {
    return absl::InvalidArgumentError(absl::StrCat("the context has keys of ", context.keys.size(),
                                                   " layers, the network has ", c.depth));
  }
  for (size_t i = 0; i < context.keys.size(); ++i) {
    for (const torch::Tensor* tensor : {&context.keys[i], &context.values[i]}) {
      RS_RETURN_IF_ERROR(CheckSizes(absl::StrCat("the context's keys or values of layer ", i),
                                    *tensor, {batch, c.kv_heads, prefix, c.head_dim}));
    }
  }
  return absl::OkStatus();
}

}  // namespace

// One prediction at a time uses a graph, whose buffers it owns.
struct OpenpiInference::Graphs {
  struct Entry {
    StepBuffers buffers;
    std::unique_ptr<StepGraph> graph;
  };
  absl::Mutex mu;
  std::map<StepShape, Entry> entries ABSL_GUARDED_BY(mu);
};

OpenpiInference::~OpenpiInference() = default;

OpenpiInference::OpenpiInference(OpenpiModel model, const InferenceOptions& options,
                                 const torch::Device& device)
    : steps_(options.steps), lora_targets_(ExpertLoraTargets(model.config)) {
  const bool bf16 = options.precision == Precision::kBf16;
  const bool flows_bf16 = options.activations == InferenceOptions::Activations::kAutomatic
                              ? MultipliesBf16(device)
                              : options.activations == InferenceOptions::Activations::kBf16;
  setup_.config = model.config;
  setup_.device = device;
  setup_.stored = bf16 ? torch::kBFloat16 : torch::kFloat32;
  setup_.activations = bf16 && flows_bf16 ? torch::kBFloat16 : torch::kFloat32;
  weights_ =
      PrepareWeights(ConvertModel(std::move(model), {setup_.stored, setup_.activations}, device),
                     EulerTimes(steps_), setup_.activations,
                     device.is_cpu() ? kJoinLimitBytes : std::numeric_limits<int64_t>::max());
  if (StepGraph::Available() && device.is_cuda()) graphs_ = std::make_unique<Graphs>();
}

absl::StatusOr<std::unique_ptr<OpenpiInference>> OpenpiInference::Create(
    OpenpiModel model, const InferenceOptions& options) {
  if (options.steps < 1 || options.steps > 1000) {
    return absl::InvalidArgumentError(
        absl::StrCat("steps is ", options.steps, ", must be in [1, 1000]"));
  }
  RS_ASSIGN_OR_RETURN(const torch::Device device, FindDevice(options.device));
  if (!device.is_cpu() && options.precision == Precision::kBf16 &&
      options.activations == InferenceOptions::Activations::kFloat32) {
    return absl::InvalidArgumentError(absl::StrCat(
        "bfloat16 weights beside float32 activations are widened for processors; device '",
        options.device, "' multiplies bfloat16: leave the activations automatic"));
  }
  try {
    const torch::NoGradGuard no_grad;
    return std::unique_ptr<OpenpiInference>(new OpenpiInference(std::move(model), options, device));
  } catch (const std::exception& error) {
    return ThrownStatus("the network cannot be prepared", error);
  }
}

absl::StatusOr<PolicyContext> OpenpiInference::Encode(const ModelInputs& inputs) const {
  try {
    const torch::NoGradGuard no_grad;
    RS_RETURN_IF_ERROR(CheckInputs(setup_.config, inputs));
    return EncodePrefix(setup_, weights_, inputs);
  } catch (const std::exception& error) {
    return ThrownStatus("encoding", error);
  }
}

absl::StatusOr<torch::Tensor> OpenpiInference::Sample(const PolicyContext& context,
                                                      const torch::Tensor& noise,
                                                      const LoraWeights* lora) const {
  try {
    const torch::NoGradGuard no_grad;
    RS_RETURN_IF_ERROR(CheckContext(setup_.config, context, noise));
    if (lora == nullptr) return Predict(context, noise, {});
    RS_RETURN_IF_ERROR(CheckLora(lora_targets_, *lora));
    return Predict(context, noise, {lora->A, lora->B, /*rows=*/false});
  } catch (const std::exception& error) {
    return ThrownStatus("sampling", error);
  }
}

absl::StatusOr<torch::Tensor> OpenpiInference::SampleRows(
    const PolicyContext& context, const torch::Tensor& noise,
    const std::vector<const LoraWeights*>& lora) const {
  try {
    const torch::NoGradGuard no_grad;
    RS_RETURN_IF_ERROR(CheckContext(setup_.config, context, noise));
    if (static_cast<int64_t>(lora.size()) != noise.size(0)) {
      return absl::InvalidArgumentError(
          absl::StrCat(lora.size(), " adapters for ", noise.size(0), " rows, must be equal"));
    }
    bool any = false;
    for (const LoraWeights* row : lora) {
      if (row == nullptr) continue;
      RS_RETURN_IF_ERROR(CheckLora(lora_targets_, *row));
      any = true;
    }
    if (!any) return Predict(context, noise, {});
    LoraRows rows = StackLora(lora_targets_, lora);
    return Predict(context, noise, {std::move(rows.A), std::move(rows.B), /*rows=*/true});
  } catch (const std::exception& error) {
    return ThrownStatus("sampling", error);
  }
}

torch::Tensor OpenpiInference::Predict(const PolicyContext& context, const torch::Tensor& noise,
                                       const Adapters& adapters) const {
  if (graphs_ != nullptr) return PredictByGraph(context, noise, adapters);
  StepBuffers buffers =
      AllocateSteps(setup_, ShapeOfPrediction(context, adapters, context.prefix_mask.size(1)));
  FillSteps(setup_, weights_, context, noise, adapters, buffers);
  RunSteps(setup_, weights_, steps_, buffers);
  return buffers.x.to(torch::kCPU);
}

torch::Tensor OpenpiInference::PredictByGraph(const PolicyContext& context,
                                              const torch::Tensor& noise,
                                              const Adapters& adapters) const {
  const int64_t prefix =
      (context.prefix_mask.size(1) + kGraphSlots - 1) / kGraphSlots * kGraphSlots;
  const StepShape shape = ShapeOfPrediction(context, adapters, prefix);
  const absl::MutexLock lock(&graphs_->mu);
  auto found = graphs_->entries.find(shape);
  if (found == graphs_->entries.end()) {
    if (graphs_->entries.size() == kMaxGraphs) graphs_->entries.erase(graphs_->entries.begin());
    found = graphs_->entries.try_emplace(shape).first;
    StepBuffers& buffers = found->second.buffers;
    buffers = AllocateSteps(setup_, shape);
    found->second.graph = StepGraph::Record(setup_.device.index(),
                                            [&] { RunSteps(setup_, weights_, steps_, buffers); });
  }
  FillSteps(setup_, weights_, context, noise, adapters, found->second.buffers);
  found->second.graph->Replay();
  return found->second.buffers.x.to(torch::kCPU);
}

}  // namespace robostress::openpi
