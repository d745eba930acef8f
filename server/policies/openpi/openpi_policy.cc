#include "server/policies/openpi/openpi_policy.h"

#include <torch/torch.h>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint_load.h"
#include "server/policies/openpi/openpi_inference.h"
#include "server/policies/openpi/openpi_lora.h"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

using torch::Tensor;

class OpenpiPolicy : public FlowPolicy {
 public:
  OpenpiPolicy(OpenpiModel model, std::unique_ptr<const Preprocessor> preprocessor,
               std::unique_ptr<const OpenpiInference> inference, const std::string& name,
               const std::string& model_hash)
      : model_(std::move(model)),
        preprocessor_(std::move(preprocessor)),
        inference_(std::move(inference)) {
    const PolicySetup& setup = preprocessor_->setup();
    spec_.name = name;
    spec_.model_hash = model_hash;
    for (const std::string& camera : setup.robot.cameras) {
      if (!camera.empty()) spec_.cameras.push_back(camera);
    }
    spec_.image_width = spec_.image_height = static_cast<int>(model_.config.image);
    spec_.state_dim = static_cast<int>(setup.robot.state_dim);
    spec_.action_dim = static_cast<int>(setup.robot.action_dim);
    spec_.horizon = static_cast<int>(model_.config.horizon);
    spec_.execute_steps = static_cast<int>(setup.execute_steps);
    spec_.adaptable = true;
    targets_ = ExpertLoraTargets(model_.config);
  }

  const PolicySpec& spec() const override { return spec_; }
  int64_t horizon() const override { return model_.config.horizon; }
  int64_t model_action_dim() const override { return model_.config.action_dim; }
  const std::vector<LoraTarget>& lora_targets() const override { return targets_; }

  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    try {
      torch::NoGradGuard no_grad;
      RS_ASSIGN_OR_RETURN(const ModelInputs inputs, preprocessor_->Prepare(observation));
      return inference_->Encode(inputs);
    } catch (const std::exception& error) {  // LibTorch reports out of memory by throwing
      return absl::InternalError(
          absl::StrCat(model_.config.name(), ": encoding failed: ", error.what()));
    }
  }

  Tensor Velocity(const PolicyContext& context, const Tensor& x_u, const Tensor& u,
                  const LoraWeights* lora) const override {
    const OpenpiModel adapted = Adapted(lora);
    return openpi::Velocity(adapted, SuffixOnCache(adapted, Prefix(context), x_u, u));
  }

  Tensor Sample(const PolicyContext& context, const Tensor& noise,
                const LoraWeights* lora) const override {
    absl::StatusOr<Tensor> actions = inference_->Sample(context, noise, lora);
    // Contexts and adapters come from this policy, so that they fit: what is left is LibTorch's.
    TORCH_CHECK(actions.ok(), actions.status().ToString());
    return *std::move(actions);
  }

  Eigen::MatrixXf ToEnvironment(const Tensor& chunk, const Tensor& state) const override {
    return preprocessor_->ToEnvironment(chunk, state);
  }

  Tensor ToModel(const Eigen::MatrixXf& actions, const Tensor& state) const override {
    return preprocessor_->ToModel(actions, state);
  }

 private:
  static PrefixContext Prefix(const PolicyContext& context) {
    PrefixContext prefix;
    prefix.cache = {context.keys, context.values};
    prefix.valid = context.prefix_mask;
    prefix.state = context.state;
    return prefix;
  }

  // The model with an adapter beside the expert's layers; tensors are shared.
  OpenpiModel Adapted(const LoraWeights* lora) const {
    return lora == nullptr ? model_ : WithLora(model_, *lora);
  }

  OpenpiModel model_;
  const std::unique_ptr<const Preprocessor> preprocessor_;
  const std::unique_ptr<const OpenpiInference> inference_;  // shares the large tensors of model_
  PolicySpec spec_;
  std::vector<LoraTarget> targets_;
};

// Of all that decides what the policy computes.
absl::StatusOr<std::string> HashOf(const Checkpoint& checkpoint, const PolicySetup& setup,
                                   PolicyOptions options) {
  options.name = options.tokenizer = options.norm_stats = "";  // decide nothing by themselves
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
    OpenpiModel model, std::unique_ptr<const Preprocessor> preprocessor, const std::string& name,
    const std::string& model_hash) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<const OpenpiInference> inference,
                      OpenpiInference::Create(model, {.steps = preprocessor->setup().euler_steps}));
  return std::make_unique<OpenpiPolicy>(std::move(model), std::move(preprocessor),
                                        std::move(inference), name, model_hash);
}

absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadOpenpiPolicy(
    const std::string& path, const std::vector<std::string>& overrides) {
  RS_ASSIGN_OR_RETURN(const PolicyOptions options, ReadPolicyOptions(path, overrides));
  RS_ASSIGN_OR_RETURN(const Checkpoint checkpoint, OpenCheckpoint(path, NetworkOptions(options)));
  SetupResult resolved = ResolveSetup(checkpoint, options);
  RS_RETURN_IF_ERROR(ProblemList(path, "cannot be served as it is", resolved.problems,
                                 "`robostress policy inspect` shows everything that is decided; "
                                 "options are keys of robostress_policy.yaml beside it"));
  RS_ASSIGN_OR_RETURN(std::unique_ptr<const Preprocessor> preprocessor,
                      Preprocessor::Create(std::move(resolved.setup), checkpoint.config));
  RS_ASSIGN_OR_RETURN(const std::string hash, HashOf(checkpoint, preprocessor->setup(), options));
  RS_ASSIGN_OR_RETURN(OpenpiModel model, LoadCheckpoint(checkpoint));
  return MakeOpenpiPolicy(std::move(model), std::move(preprocessor),
                          options.name.empty() ? path : options.name, hash);
}

}  // namespace robostress::openpi
