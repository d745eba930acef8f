#include "server/policies/openpi/openpi_policy.h"

#include <torch/types.h>

#include "absl/strings/str_cat.h"
#include "adapter/thrown_status.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint_load.h"
#include "server/policies/openpi/compute_threads.h"
#include "server/policies/openpi/openpi_inference.h"
#include "server/policies/openpi/openpi_lora.h"
#include "server/policies/openpi/precision.h"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

using torch::Tensor;

// Where and how a policy computes.
struct Compute {
  torch::Device device = torch::kCPU;
  int threads = 1;
  torch::ScalarType kv_type = torch::kFloat32;  // of a prefix's keys and values
  bool widen_expert = false;  // for gradients: bfloat16 weights that the device multiplies slowly
};

Tensor OnDevice(const Tensor& tensor, const torch::Device& device) {
  return tensor.defined() ? tensor.to(device) : tensor;
}

std::vector<Tensor> OnDevice(std::vector<Tensor> tensors, const torch::Device& device) {
  for (Tensor& tensor : tensors) tensor = OnDevice(tensor, device);
  return tensors;
}

class OpenpiPolicy : public FlowPolicy {
 public:
  OpenpiPolicy(OpenpiModel model, std::unique_ptr<const Preprocessor> preprocessor,
               std::unique_ptr<const OpenpiInference> inference, const Compute& compute,
               const std::string& name, const std::string& model_hash)
      : model_(std::move(model)),
        preprocessor_(std::move(preprocessor)),
        inference_(std::move(inference)),
        compute_(compute) {
    const PolicySetup& setup = preprocessor_->setup();
    spec_.name = name;
    spec_.model_hash = model_hash;
    for (const std::string& camera : setup.robot.cameras) {
      if (!camera.empty()) spec_.cameras.push_back(camera);
    }
    spec_.image_width = spec_.image_height = static_cast<int>(model_.config.image);
    spec_.resizes_images = true;
    spec_.state_dim = static_cast<int>(setup.robot.state_dim);
    spec_.action_dim = static_cast<int>(setup.robot.action_dim);
    spec_.horizon = static_cast<int>(model_.config.horizon);
    spec_.execute_steps = static_cast<int>(setup.execute_steps);
    spec_.adaptable = true;
    spec_.control_space = setup.robot.control_space;
    DeclareActionRange(setup);
    targets_ = ExpertLoraTargets(model_.config);
  }

  const PolicySpec& spec() const override { return spec_; }
  int64_t horizon() const override { return model_.config.horizon; }
  int64_t model_action_dim() const override { return model_.config.action_dim; }
  const std::vector<LoraTarget>& lora_targets() const override { return targets_; }
  ContextShape context_shape() const override {
    const OpenpiConfig& c = model_.config;
    return {.layers = c.depth,
            .kv_heads = c.kv_heads,
            .head_dim = c.head_dim,
            .kv_type = compute_.kv_type,
            .max_prefix = static_cast<int64_t>(kImageSlots.size()) * c.patches() + c.prompt_tokens,
            .state_dim = c.action_dim};
  }

  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    try {
      torch::NoGradGuard no_grad;
      UseThreads();
      RS_ASSIGN_OR_RETURN(const ModelInputs inputs, preprocessor_->Prepare(observation));
      return inference_->Encode(inputs);
    } catch (const std::exception& error) {
      return ThrownStatus(absl::StrCat(model_.config.name(), ": encoding"), error);
    }
  }

  Tensor Velocity(const PolicyContext& context, const Tensor& x_u, const Tensor& u,
                  const LoraWeights* lora) const override {
    UseThreads();
    const OpenpiModel adapted = Adapted(lora);
    const Tensor out = SuffixOnCache(adapted, Prefix(context), OnDevice(x_u, compute_.device),
                                     OnDevice(u, compute_.device));
    return openpi::Velocity(adapted, out).to(torch::kCPU);
  }

  Tensor Sample(const PolicyContext& context, const Tensor& noise,
                const LoraWeights* lora) const override {
    UseThreads();
    absl::StatusOr<Tensor> actions = inference_->Sample(context, noise, lora);
    // Contexts and adapters come from this policy, so that they fit: what is left is LibTorch's.
    TORCH_CHECK(actions.ok(), actions.status().ToString());
    return *std::move(actions);
  }

  Tensor SampleRows(const PolicyContext& context, const Tensor& noise,
                    const std::vector<const LoraWeights*>& lora) const override {
    UseThreads();
    absl::StatusOr<Tensor> actions = inference_->SampleRows(context, noise, lora);
    TORCH_CHECK(actions.ok(), actions.status().ToString());  // as in Sample
    return *std::move(actions);
  }

  // Products of several rows are split differently than those of one.
  bool exact_rows() const override { return false; }

  Eigen::MatrixXf ToEnvironment(const Tensor& chunk, const Tensor& state) const override {
    return preprocessor_->ToEnvironment(chunk, state);
  }

  Tensor ToModel(const Eigen::MatrixXf& actions, const Tensor& state) const override {
    return preprocessor_->ToModel(actions, state);
  }

 private:
  // From the 1st to the 99th percentile of the training data, where they are of what the robot is
  // sent: statistics of delta actions are not, and a mean and a deviation bound nothing.
  void DeclareActionRange(const PolicySetup& setup) {
    const auto found = setup.stats.fields.find("actions");
    if (setup.delta || found == setup.stats.fields.end() || !found->second.has_quantiles()) return;
    const FieldStats& stats = found->second;
    const auto dims = static_cast<size_t>(spec_.action_dim);
    if (stats.q01.size() < dims) return;
    spec_.action_low.assign(stats.q01.begin(), stats.q01.begin() + spec_.action_dim);
    spec_.action_high.assign(stats.q99.begin(), stats.q99.begin() + spec_.action_dim);
  }

  // The threads that compute are the server's, which limits each to one core at its first use.
  void UseThreads() const {
    if (compute_.threads > 1) SetComputeThreads(compute_.threads);
  }

  PrefixContext Prefix(const PolicyContext& context) const {
    PrefixContext prefix;
    prefix.cache = {OnDevice(context.keys, compute_.device),
                    OnDevice(context.values, compute_.device)};
    prefix.valid = OnDevice(context.prefix_mask, compute_.device);
    prefix.state = OnDevice(context.state, compute_.device);
    return prefix;
  }

  // The model with an adapter beside the expert's layers. Tensors are shared, but for an expert
  // that is widened.
  OpenpiModel Adapted(const LoraWeights* lora) const {
    const OpenpiModel model = compute_.widen_expert ? WithFloat32Expert(model_) : model_;
    if (lora == nullptr) return model;
    return WithLora(model, LoraWeights{OnDevice(lora->A, compute_.device),
                                       OnDevice(lora->B, compute_.device), lora->version});
  }

  OpenpiModel model_;
  const std::unique_ptr<const Preprocessor> preprocessor_;
  const std::unique_ptr<const OpenpiInference> inference_;  // shares the large tensors of model_
  const Compute compute_;
  PolicySpec spec_;
  std::vector<LoraTarget> targets_;
};

// Of all that decides what the policy computes.
absl::StatusOr<std::string> HashOf(const Checkpoint& checkpoint, const PolicySetup& setup,
                                   PolicyOptions options) {
  // These decide nothing by themselves.
  options.name = options.tokenizer = options.norm_stats = options.device = "";
  options.threads = 0;
  std::string text = DumpConfig(options);
  for (const auto& shard : checkpoint.shards) {
    RS_ASSIGN_OR_RETURN(const std::string hash, Sha256OfFile(shard->path()));
    absl::StrAppend(&text, hash, "\n");
  }
  if (!setup.stats.source.empty()) {
    RS_ASSIGN_OR_RETURN(const std::string hash, Sha256OfFile(setup.stats.source));
    absl::StrAppend(&text, hash, "\n");
  }
  RS_ASSIGN_OR_RETURN(const std::string tokenizer, Sha256OfFile(setup.tokenizer));
  return Sha256Hex(absl::StrCat(text, tokenizer));
}

}  // namespace

absl::StatusOr<std::unique_ptr<FlowPolicy>> MakeOpenpiPolicy(
    OpenpiModel model, std::unique_ptr<const Preprocessor> preprocessor,
    const PolicyOptions& options, const std::string& name, const std::string& model_hash) {
  const bool bf16 = options.precision == PrecisionSetting::kBf16;
  Compute compute;
  RS_ASSIGN_OR_RETURN(compute.device, FindDevice(options.device));
  compute.threads = static_cast<int>(options.threads);
  compute.kv_type = bf16 ? torch::kBFloat16 : torch::kFloat32;
  compute.widen_expert = bf16 && !MultipliesBf16(compute.device);
  if (!compute.device.is_cpu()) {  // once, for the inference and for gradients
    const torch::Dtype dtype = bf16 ? torch::kBFloat16 : torch::kFloat32;
    model = ConvertModel(std::move(model), {dtype, dtype}, compute.device);
  }
  RS_ASSIGN_OR_RETURN(
      std::unique_ptr<const OpenpiInference> inference,
      OpenpiInference::Create(model, {.precision = bf16 ? Precision::kBf16 : Precision::kFloat32,
                                      .device = options.device,
                                      .steps = preprocessor->setup().euler_steps}));
  return std::make_unique<OpenpiPolicy>(std::move(model), std::move(preprocessor),
                                        std::move(inference), compute, name, model_hash);
}

absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadOpenpiPolicy(
    const std::string& path, const std::vector<std::string>& overrides) {
  RS_ASSIGN_OR_RETURN(const PolicyOptions options, ReadPolicyOptions(path, overrides));
  RS_ASSIGN_OR_RETURN(const Checkpoint checkpoint, OpenCheckpoint(path, NetworkOptions(options)));
  SetupResult resolved = ResolveSetup(checkpoint, options);
  if (const absl::Status device = FindDevice(options.device).status(); !device.ok())
    resolved.problems.emplace_back(device.message());
  RS_RETURN_IF_ERROR(ProblemList(path, "cannot be served as it is", resolved.problems,
                                 "`robostress policy inspect` shows everything that is decided; "
                                 "options are keys of robostress_policy.yaml beside it"));
  RS_ASSIGN_OR_RETURN(std::unique_ptr<const Preprocessor> preprocessor,
                      Preprocessor::Create(std::move(resolved.setup), checkpoint.config));
  RS_ASSIGN_OR_RETURN(const std::string hash, HashOf(checkpoint, preprocessor->setup(), options));
  const auto precision = options.precision == PrecisionSetting::kBf16 ? WeightPrecision::kBf16
                                                                      : WeightPrecision::kFloat32;
  RS_ASSIGN_OR_RETURN(OpenpiModel model, LoadCheckpoint(checkpoint, {.precision = precision}));
  return MakeOpenpiPolicy(std::move(model), std::move(preprocessor), options,
                          options.name.empty() ? path : options.name, hash);
}

}  // namespace robostress::openpi
