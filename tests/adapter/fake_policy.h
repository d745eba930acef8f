#pragma once

#include <torch/types.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "adapter/lora.h"
#include "common/random.h"
#include "server/policies/policy.h"

namespace robostress {

// A flow policy in a dozen lines: v = W2 tanh(W1 x + U k + S s + t u), with LoRA on W1 and W2. It
// computes in the precision of x_u, so that a gradient can be compared with finite differences in
// double.
class FakePolicy : public FlowPolicy {
 public:
  static constexpr int64_t kHorizon = 10, kDim = 8, kWidth = 12, kState = 3;
  static constexpr float kScale = 0.15f;

  explicit FakePolicy(const std::string& hash = "fake-hash") {
    spec_.name = "fake";
    spec_.model_hash = hash;
    spec_.cameras = {};
    spec_.state_dim = kState;
    spec_.action_dim = 7;
    spec_.horizon = kHorizon;
    spec_.execute_steps = 5;
    spec_.adaptable = true;
    spec_.action_low.assign(7, -1.0f);
    spec_.action_high.assign(7, 1.0f);
    targets_ = {{"in", kDim, kWidth, 3}, {"out", kWidth, kDim, 1, 2}};
    W1_ = Random("W1", {kWidth, kDim}, 0.3);
    W2_ = Random("W2", {kDim, kWidth}, 0.3);
    U_ = Random("U", {kWidth, 4}, 0.5);
    S_ = Random("S", {kWidth, kState}, 0.5);
    t_ = Random("t", {kWidth}, 0.5);
  }

  int64_t horizon() const override { return kHorizon; }
  int64_t model_action_dim() const override { return kDim; }
  const std::vector<LoraTarget>& lora_targets() const override { return targets_; }
  ContextShape context_shape() const override {
    return {.layers = 1, .kv_heads = 1, .head_dim = 4, .max_prefix = 8, .state_dim = kState};
  }
  const PolicySpec& spec() const override { return spec_; }

  torch::Tensor Velocity(const PolicyContext& context, const torch::Tensor& x_u,
                         const torch::Tensor& u, const LoraWeights* lora) const override {
    const auto type = x_u.options();
    const auto linear = [&](const torch::Tensor& x, const torch::Tensor& W, size_t target) {
      torch::Tensor y = torch::matmul(x, W.to(type).t());
      if (lora != nullptr) y = y + LoraDelta(x, lora->A[target], lora->B[target]);
      return y;
    };
    const torch::Tensor key = context.keys[0].to(type).mean(c10::IntArrayRef{1, 2});  // [B, 4]
    torch::Tensor h = linear(x_u, W1_, 0);  // [B, K, width]
    h = h + (torch::matmul(key, U_.to(type).t()) +
             torch::matmul(context.state.to(type), S_.to(type).t()))
                .unsqueeze(1);
    h = h + u.to(type).reshape({-1, 1, 1}) * t_.to(type);
    return linear(torch::tanh(h), W2_, 1);
  }

  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    if (observation.proprioception.size() != kState) return absl::InvalidArgumentError("state");
    PolicyContext context;
    context.state = torch::empty({1, kState});
    for (int i = 0; i < kState; ++i) context.state[0][i] = observation.proprioception[i];
    context.keys = {Random("key:" + observation.instruction, {1, 1, 2, 4}, 1)};
    context.values = {Random("value:" + observation.instruction, {1, 1, 2, 4}, 1)};
    context.prefix_mask = torch::ones({1, 2}, torch::kBool);
    return context;
  }

  torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                       const LoraWeights* lora) const override {
    torch::NoGradGuard no_grad;
    torch::Tensor x = noise;
    for (int i = 10; i >= 1; --i) {
      x = x - Velocity(context, x, torch::full({x.size(0)}, i / 10.0), lora) / 10;
    }
    return x;
  }

  // Environment = kScale x model + 0.02 x channel index: commands stay within +-1.
  Eigen::MatrixXf ToEnvironment(const torch::Tensor& chunk, const torch::Tensor&) const override {
    const torch::Tensor rows = chunk.contiguous();
    const auto values = rows.accessor<float, 2>();
    Eigen::MatrixXf actions(rows.size(0), 7);
    for (int i = 0; i < actions.rows(); ++i) {
      for (int j = 0; j < 7; ++j) actions(i, j) = kScale * values[i][j] + 0.02f * j;
    }
    return actions;
  }

  torch::Tensor ToModel(const Eigen::MatrixXf& actions, const torch::Tensor&) const override {
    torch::Tensor rows = torch::empty({actions.rows(), 7});
    auto values = rows.accessor<float, 2>();
    for (int i = 0; i < actions.rows(); ++i) {
      for (int j = 0; j < 7; ++j) values[i][j] = (actions(i, j) - 0.02f * j) / kScale;
    }
    return rows;
  }

  static torch::Tensor Random(const std::string& name, const std::vector<int64_t>& shape,
                              double scale) {
    torch::Tensor tensor = torch::empty(shape, torch::kFloat32);
    RandomStream stream(StreamKey("fake_policy").With(name));
    for (int64_t i = 0; i < tensor.numel(); ++i) {
      tensor.data_ptr<float>()[i] = static_cast<float>(scale * stream.Normal());
    }
    return tensor;
  }

  static Observation MakeObservation(int index,
                                     const std::string& instruction = "put the bowl on the plate") {
    Observation observation;
    observation.instruction = instruction;
    observation.proprioception = Eigen::VectorXf(kState);
    for (int i = 0; i < kState; ++i) observation.proprioception[i] = std::sin(0.7f * index + i);
    return observation;
  }

 private:
  PolicySpec spec_;
  std::vector<LoraTarget> targets_;
  torch::Tensor W1_, W2_, U_, S_, t_;
};

inline std::shared_ptr<const Observation> Shared(Observation observation) {
  return std::make_shared<const Observation>(std::move(observation));
}

// Equal in every bit, not just close.
inline bool BitEqual(const torch::Tensor& a, const torch::Tensor& b) {
  const torch::Tensor x = a.contiguous(), y = b.contiguous();
  return x.sizes() == y.sizes() && x.dtype() == y.dtype() &&
         std::memcmp(x.data_ptr(), y.data_ptr(), x.nbytes()) == 0;
}

inline bool BitEqual(const LoraWeights& a, const LoraWeights& b) {
  const std::vector<torch::Tensor> x = Parameters(a), y = Parameters(b);
  if (x.size() != y.size() || a.version != b.version) return false;
  for (size_t i = 0; i < x.size(); ++i) {
    if (!BitEqual(x[i], y[i])) return false;
  }
  return true;
}

}  // namespace robostress
