#include "server/policies/openpi/quantities.h"

#include <torch/autograd.h>
#include <torch/types.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/policies/openpi/masks.h"
#include "server/policies/openpi/prompt.h"

namespace robostress::openpi {
namespace {

// Makes the asked-for parameters leaves of the graph; all others stay frozen.
struct LeafVisitor : ParameterVisitor {
  explicit LeafVisitor(const std::set<std::string>& w) : wanted(w) {}
  void OnTensor(const std::string& name, const std::vector<int64_t>&,
                torch::Tensor& tensor) override {
    if (!wanted.contains(name)) return;
    tensor = tensor.detach().requires_grad_();
    leaves[name] = tensor;
  }
  void OnLinear(const std::string& name, int64_t in, int64_t out, bool bias,
                Linear& linear) override {
    ParameterVisitor::OnLinear(name, in, out, bias, linear);
    if (!linear.lora_A.defined()) return;
    OnTensor(name + ".lora_A.weight", {}, linear.lora_A);
    OnTensor(name + ".lora_B.weight", {}, linear.lora_B);
  }
  const std::set<std::string>& wanted;
  std::map<std::string, torch::Tensor> leaves;
};

// The tied embedding has two names and one gradient.
std::string Untied(absl::string_view name) {
  return name == kTiedHeadName ? kEmbeddingName : std::string(name);
}

}  // namespace

Quantities::Quantities(OpenpiModel model, OracleInputs inputs,
                       const std::set<std::string>& gradients, int64_t euler_steps)
    : model_(std::move(model)), inputs_(std::move(inputs)), euler_steps_(euler_steps) {
  std::set<std::string> wanted;
  for (const std::string& name : gradients) wanted.insert(Untied(name));
  LeafVisitor visitor(wanted);
  VisitParameters(model_.config, model_.weights, visitor);
  leaves_ = std::move(visitor.leaves);
}

const Tokens& Quantities::prefix() {
  if (!prefix_) prefix_ = EmbedPrefix(model_, inputs_.model);
  return *prefix_;
}

const PrefixContext& Quantities::context() {
  if (!context_) context_ = EncodePrefix(model_, prefix(), inputs_.model.state);
  return *context_;
}

const FlowLoss& Quantities::loss() {
  if (!loss_) {
    const at::AutoGradMode record(!leaves_.empty());
    loss_ = ComputeFlowLoss(model_, inputs_.model, inputs_.loss_actions, inputs_.loss_noise,
                            inputs_.loss_time);
  }
  return *loss_;
}

absl::StatusOr<torch::Tensor> Quantities::Compute(const std::string& name) {
  const torch::NoGradGuard no_grad;
  const bool of_loss = name.starts_with("loss.") || name.starts_with("grad/");
  if (of_loss && !inputs_.loss_time.defined()) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, " needs inputs/loss.{actions,noise,time}, which the io file lacks"));
  }
  if (name == "state_bins") {
    if (inputs_.model.state.defined()) return StateBins();
    return absl::InvalidArgumentError("state_bins needs inputs/state, which the io file lacks");
  }
  using Method = torch::Tensor (Quantities::*)(const std::string&);
  for (const Method method :
       {&Quantities::PrefixQuantity, &Quantities::CacheQuantity, &Quantities::SuffixQuantity,
        &Quantities::TimedQuantity, &Quantities::EulerQuantity, &Quantities::LossQuantity,
        &Quantities::GradientQuantity}) {
    if (torch::Tensor value = (this->*method)(name); value.defined()) return value;
  }
  return VisionQuantity(name);
}

torch::Tensor Quantities::ComputeByOtherPass(const std::string& name) {
  const torch::NoGradGuard no_grad;
  if (name == "loss.v_t") {
    return Velocity(model_,
                    SuffixOnCache(model_, context(), loss().x_t.detach(), inputs_.loss_time));
  }
  absl::string_view text = name;
  float t = 0;
  if (!absl::ConsumePrefix(&text, "v_t") || !absl::SimpleAtof(text, &t)) return {};
  const torch::Tensor time = at::full({inputs_.noise.size(0)}, t);
  return Velocity(model_, SuffixJoint(model_, prefix(), inputs_.model.state, inputs_.noise, time));
}

torch::Tensor Quantities::VisionQuantity(const std::string& name) const {
  for (size_t i = 0; i < inputs_.cameras.size(); ++i) {
    const std::string& camera = inputs_.cameras[i];
    const torch::Tensor& images = inputs_.model.images[i];
    const auto run = [&] {
      return RunSiglip(model_.weights.vision, model_.config.vision_heads, images);
    };
    if (name == "image_embeds." + camera) return EmbedImage(model_, images);
    if (name == "siglip.patch_pos." + camera) return run().patch_pos;
    if (name == "siglip.post_layernorm." + camera) return run().features;
  }
  return {};
}

torch::Tensor Quantities::PrefixQuantity(const std::string& name) {
  if (!name.starts_with("prefix.")) return {};
  const Tokens& tokens = prefix();
  if (name == "prefix.embs") return tokens.embeddings;
  if (name == "prefix.pad_mask") return tokens.valid;
  if (name == "prefix.ar_mask") return tokens.starts;
  if (name == "prefix.att_2d_mask") return BlockMask(tokens.valid, tokens.starts);
  if (name == "prefix.position_ids") return Positions(tokens.valid);
  if (name == "prefix.out_normed") return context().out_normed;
  return {};
}

torch::Tensor Quantities::CacheQuantity(const std::string& name) {
  for (int64_t layer = 0; layer < model_.config.depth; ++layer) {
    if (name == absl::StrCat("kv.", layer, ".key")) return context().cache.keys[layer];
    if (name == absl::StrCat("kv.", layer, ".value")) return context().cache.values[layer];
  }
  return {};
}

torch::Tensor Quantities::SuffixQuantity(const std::string& name) {
  if (!name.starts_with("suffix.")) return {};
  const torch::Tensor time = at::ones({inputs_.noise.size(0)});
  const Tokens suffix = EmbedSuffix(model_, inputs_.model.state, inputs_.noise, time);
  if (name == "suffix.pad_mask") return suffix.valid;
  if (name == "suffix.ar_mask") return suffix.starts;
  if (name == "suffix.att_2d_mask") return SuffixMask(prefix().valid, suffix.valid, suffix.starts);
  if (name == "suffix.position_ids") return SuffixPositions(prefix().valid, suffix.valid);
  return {};
}

torch::Tensor Quantities::TimedQuantity(const std::string& name) {
  const auto time_after = [&](absl::string_view prefix) -> std::optional<torch::Tensor> {
    absl::string_view text = name;
    float t = 0;
    if (!absl::ConsumePrefix(&text, prefix) || !absl::SimpleAtof(text, &t)) return std::nullopt;
    return at::full({inputs_.noise.size(0)}, t);
  };
  const torch::Tensor& state = inputs_.model.state;
  if (auto t = time_after("time_emb_t")) return EmbedTime(*t, model_.config.expert_width);
  if (auto t = time_after("adarms_cond_t"); t && model_.config.pi05)
    return TimeCondition(model_, *t);
  if (auto t = time_after("suffix.embs_t"))
    return EmbedSuffix(model_, state, inputs_.noise, *t).embeddings;
  if (auto t = time_after("suffix.out_normed_t"))
    return SuffixOnCache(model_, context(), inputs_.noise, *t);
  if (auto t = time_after("v_t"))
    return Velocity(model_, SuffixOnCache(model_, context(), inputs_.noise, *t));
  return {};
}

torch::Tensor Quantities::EulerQuantity(const std::string& name) {
  if (name != "euler.time" && name != "euler.x" && name != "actions") return {};
  if (!euler_) euler_ = IntegrateEuler(model_, context(), inputs_.noise, euler_steps_);
  if (name == "euler.time") return torch::tensor(euler_->times);
  return name == "euler.x" ? at::stack(euler_->xs) : euler_->xs.back();
}

torch::Tensor Quantities::LossQuantity(const std::string& name) {
  if (!name.starts_with("loss.")) return {};
  if (name == "loss.x_t") return loss().x_t.detach();
  if (name == "loss.u_t") return loss().u_t.detach();
  if (name == "loss.v_t") return loss().v_t.detach();
  if (name == "loss.elements") return loss().elements.detach();
  if (name == "loss.mean") return loss().mean.detach().view({1});
  const Tokens suffix =
      EmbedSuffix(model_, inputs_.model.state, inputs_.loss_noise, inputs_.loss_time);
  const torch::Tensor valid = at::cat({prefix().valid, suffix.valid}, 1);
  if (name == "loss.att_2d_mask")
    return BlockMask(valid, at::cat({prefix().starts, suffix.starts}, 1));
  if (name == "loss.position_ids") return Positions(valid);
  return {};
}

torch::Tensor Quantities::GradientQuantity(const std::string& name) {
  absl::string_view parameter = name;
  if (!absl::ConsumePrefix(&parameter, "grad/")) return {};
  if (gradients_.empty() && !leaves_.empty()) {
    std::vector<torch::Tensor> leaves;
    for (const auto& [leaf, tensor] : leaves_) leaves.push_back(tensor);
    const auto gradients = torch::autograd::grad({loss().mean}, leaves, {}, c10::nullopt, false,
                                                 /*allow_unused=*/true);
    size_t i = 0;
    for (const auto& [leaf, tensor] : leaves_) {
      const torch::Tensor& gradient = gradients[i++];
      // The loss does not depend on what the prefix's last layer does after its keys and values.
      gradients_[leaf] = gradient.defined() ? gradient : at::zeros_like(tensor);
    }
  }
  const auto found = gradients_.find(Untied(parameter));
  return found == gradients_.end() ? torch::Tensor() : found->second;
}

torch::Tensor Quantities::StateBins() const {
  const int64_t size =
      model_.config.state_dim > 0 ? model_.config.state_dim : model_.config.action_dim;
  const torch::Tensor state =
      inputs_.model.state.narrow(1, 0, size).to(torch::kFloat64).contiguous();
  const std::vector<int64_t> bins = openpi::StateBins(
      absl::MakeConstSpan(state.data_ptr<double>(), static_cast<size_t>(state.numel())));
  return torch::tensor(bins, torch::kInt64).view(state.sizes());
}

}  // namespace robostress::openpi
