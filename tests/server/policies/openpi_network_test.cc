// pi0 and pi0.5 without an oracle: what must hold for any weights.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/autograd.h>
#include <torch/types.h>

#include <cmath>
#include <tuple>

#include "server/policies/openpi/masks.h"
#include "server/policies/openpi/openpi_lora.h"
#include "tests/server/policies/tiny_openpi.h"

namespace robostress::openpi {
namespace {

double MaxDifference(const torch::Tensor& a, const torch::Tensor& b) {
  return (a - b).abs().max().item<double>();
}

torch::Tensor JointVelocity(const OpenpiModel& model, const OracleInputs& in) {
  return Velocity(model, SuffixJoint(model, EmbedPrefix(model, in.model), in.model.state, in.noise,
                                     in.loss_time));
}

torch::Tensor CachedVelocity(const OpenpiModel& model, const OracleInputs& in) {
  const PrefixContext context = EncodePrefix(model, EmbedPrefix(model, in.model), in.model.state);
  return Velocity(model, SuffixOnCache(model, context, in.noise, in.loss_time));
}

// An adapter of rank 3 on every linear layer of the network, or only on those of one part.
OpenpiLora RandomLora(const OpenpiConfig& config, const std::string& part, double b_std) {
  struct Collect : ParameterVisitor {
    void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor&) override {}
    void OnLinear(const std::string& name, int64_t in, int64_t out, bool, Linear&) override {
      if (name.find(part) == std::string::npos) return;
      lora.pairs[name] = {at::randn({3, in}) * 0.3, at::randn({out, 3}) * b_std};
    }
    OpenpiLora lora;
    std::string part;
    double b_std = 0;
  } collect;
  collect.part = part;
  collect.b_std = b_std;
  collect.lora.scale = 0.5;
  torch::manual_seed(3);
  OpenpiWeights weights;
  VisitParameters(config, weights, collect);
  return collect.lora;
}

// pi05, cameras, padded.
class OpenpiNetwork : public ::testing::TestWithParam<std::tuple<bool, int, bool>> {
 protected:
  OpenpiConfig config_ = TinyConfig(std::get<0>(GetParam()));
  OpenpiModel model_ = RandomOpenpiModel(config_, 5);
  OracleInputs inputs_ =
      RandomInputs(config_, 3, std::get<1>(GetParam()), std::get<2>(GetParam()), 11);
  torch::NoGradGuard no_grad_;
};

INSTANTIATE_TEST_SUITE_P(Models, OpenpiNetwork,
                         ::testing::Combine(::testing::Bool(), ::testing::Values(1, 2, 4),
                                            ::testing::Bool()));

TEST_P(OpenpiNetwork, CachedPassEqualsJointPass) {
  const torch::Tensor joint = JointVelocity(model_, inputs_);
  EXPECT_GT(joint.abs().mean().item<double>(), 0.1);
  // float32 sums of at most 36 terms in another order
  EXPECT_LT(MaxDifference(CachedVelocity(model_, inputs_), joint), 1e-5);
}

TEST_P(OpenpiNetwork, ReadsNothingThatIsMaskedOut) {
  const torch::Tensor before = CachedVelocity(model_, inputs_);
  for (size_t i = 0; i < inputs_.model.images.size(); ++i) {
    const torch::Tensor absent = inputs_.model.image_masks[i].logical_not().view({-1, 1, 1, 1});
    inputs_.model.images[i] =
        at::where(absent, at::randn_like(inputs_.model.images[i]), inputs_.model.images[i]);
  }
  inputs_.model.tokens = at::where(inputs_.model.token_mask, inputs_.model.tokens,
                                   at::zeros_like(inputs_.model.tokens));
  EXPECT_LT(MaxDifference(CachedVelocity(model_, inputs_), before), 1e-6);
}

TEST_P(OpenpiNetwork, EveryInputMatters) {
  const torch::Tensor before = CachedVelocity(model_, inputs_);
  const auto moves = [&](const OracleInputs& changed) {
    return MaxDifference(CachedVelocity(model_, changed), before) > 1e-4;
  };
  OracleInputs changed = inputs_;
  changed.model.images.back() = changed.model.images.back() + 0.5;
  EXPECT_TRUE(moves(changed));
  changed = inputs_;
  changed.model.tokens = (changed.model.tokens + 1).remainder(config_.vocab);
  EXPECT_TRUE(moves(changed));
  changed = inputs_;
  changed.loss_time = changed.loss_time + 0.04;
  EXPECT_TRUE(moves(changed));
  changed = inputs_;
  changed.model.state = changed.model.state + 0.5;
  EXPECT_EQ(moves(changed), !config_.pi05);  // pi0.5 reads its state in the prompt
}

TEST_P(OpenpiNetwork, KeyHeadsServeTheirGroupOfQueryHeads) {
  // The same network with every key and value head written out once per query head.
  OpenpiModel wide = model_;
  wide.config.kv_heads = config_.heads;
  const auto repeat = [&](Linear& linear) {
    const int64_t in = linear.weight.size(1);
    linear.weight = linear.weight.view({config_.kv_heads, config_.head_dim, in})
                        .repeat_interleave(config_.heads / config_.kv_heads, 0)
                        .reshape({-1, in});
  };
  for (GemmaStack* stack : {&wide.weights.prefix, &wide.weights.expert}) {
    for (GemmaLayer& layer : stack->layers) {
      repeat(layer.k);
      repeat(layer.v);
    }
  }
  EXPECT_LT(MaxDifference(CachedVelocity(wide, inputs_), CachedVelocity(model_, inputs_)), 1e-5);
}

TEST_P(OpenpiNetwork, LoraWithZeroBChangesNothing) {
  const OpenpiModel adapted = WithLora(model_, RandomLora(config_, "", 0));
  EXPECT_TRUE(at::equal(CachedVelocity(adapted, inputs_), CachedVelocity(model_, inputs_)));
}

TEST_P(OpenpiNetwork, LoraEqualsMergedWeights) {
  const OpenpiLora lora = RandomLora(config_, "", 0.3);
  struct Merge : ParameterVisitor {
    void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor&) override {}
    void OnLinear(const std::string& name, int64_t, int64_t, bool, Linear& linear) override {
      const auto& pair = lora->pairs.at(name);
      linear.weight = linear.weight + lora->scale * at::matmul(pair.B, pair.A);
    }
    const OpenpiLora* lora = nullptr;
  } merge;
  merge.lora = &lora;
  OpenpiModel merged = model_;
  VisitParameters(config_, merged.weights, merge);
  const torch::Tensor expected = CachedVelocity(merged, inputs_);
  EXPECT_GT(MaxDifference(expected, CachedVelocity(model_, inputs_)), 1e-2);
  EXPECT_LT(MaxDifference(CachedVelocity(WithLora(model_, lora), inputs_), expected), 2e-5);
}

TEST_P(OpenpiNetwork, ExpertGradientsAgreeBetweenPassesAndWithDifferences) {
  OpenpiLora lora = RandomLora(config_, "gemma_expert", 0.3);
  std::vector<torch::Tensor> parameters, direction;
  for (auto& [name, pair] : lora.pairs) {
    for (torch::Tensor* tensor : {&pair.A, &pair.B}) {
      parameters.push_back(tensor->requires_grad_());
      direction.push_back(at::randn_like(*tensor));
    }
  }
  const OpenpiModel adapted = WithLora(model_, lora);
  const auto joint = [&] {
    return ComputeFlowLoss(adapted, inputs_.model, inputs_.loss_actions, inputs_.loss_noise,
                           inputs_.loss_time);
  };
  const auto cached = [&] {  // the adapter's way: the frozen prefix is not differentiated
    const FlowLoss targets = joint();
    const PrefixContext context =
        EncodePrefix(adapted, EmbedPrefix(adapted, inputs_.model), inputs_.model.state);
    const at::AutoGradMode record(true);
    const torch::Tensor v =
        Velocity(adapted, SuffixOnCache(adapted, context, targets.x_t.detach(), inputs_.loss_time));
    return (targets.u_t.detach() - v).square().mean();
  };
  std::vector<torch::Tensor> by_joint;
  {
    const at::AutoGradMode record(true);
    by_joint = torch::autograd::grad({joint().mean}, parameters);
  }
  const std::vector<torch::Tensor> by_cache = torch::autograd::grad({cached()}, parameters);
  double slope = 0;
  for (size_t i = 0; i < parameters.size(); ++i) {
    const double largest = by_joint[i].abs().max().item<double>();
    EXPECT_LT(MaxDifference(by_joint[i], by_cache[i]), 1e-4 * largest + 1e-7) << i;
    slope += (by_joint[i] * direction[i]).sum().item<double>();
  }
  constexpr double kStep = 1e-3;  // of float32's loss: both errors are then near 1e-3 of the slope
  const auto loss_at = [&](double step) {
    for (size_t i = 0; i < parameters.size(); ++i) parameters[i].add_(direction[i], step);
    const double loss = joint().mean.item<double>();
    for (size_t i = 0; i < parameters.size(); ++i) parameters[i].sub_(direction[i], step);
    return loss;
  };
  const double difference = (loss_at(kStep) - loss_at(-kStep)) / (2 * kStep);
  EXPECT_NEAR(difference, slope, 0.02 * std::abs(slope) + 1e-3);
}

// The sizes of the published networks, as far as the adapter depends on them.
OpenpiConfig FullExpert() {
  OpenpiConfig c;
  c.expert_width = 1024, c.expert_mlp = 4096, c.depth = 18;
  c.heads = 8, c.kv_heads = 1, c.head_dim = 256;
  return c;
}

LoraWeights RandomExpertLora(const OpenpiConfig& config, LoraKind kind, int64_t rank = 4) {
  LoraWeights lora;
  for (const LoraTarget& target : ExpertLoraTargets(config)) {
    const LoraShape shape = LoraShapeOf(target, kind, rank);
    lora.A.push_back(at::randn(shape.A) * 0.2);
    lora.B.push_back(at::randn(shape.B) * 0.2);
  }
  return lora;
}

TEST(OpenpiExpertLora, HasThePapersCountPerHeadAndPlainLorasPerMatrix) {
  const std::vector<LoraTarget> targets = ExpertLoraTargets(FullExpert());
  EXPECT_EQ(targets.size(), 18u * 7u);
  EXPECT_EQ(NumLoraParameters(targets, LoraKind::kPerHead, 4), 2'764'800);
  EXPECT_EQ(NumLoraParameters(targets, LoraKind::kPerMatrix, 4), 1'732'608);
  EXPECT_EQ(NumLoraParameters(targets, LoraKind::kPerHead, 32), 22'118'400);
}

// The joint pass through both experts, with the adapter in the weights: what an update computes
// without stored prefixes.
TEST_P(OpenpiNetwork, UpdateOnStoredPrefixesIsTheFullComputation) {
  struct Merge : ParameterVisitor {
    void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor&) override {}
    void OnLinear(const std::string& name, int64_t, int64_t, bool, Linear& linear) override {
      const auto found = products.find(name);
      if (found != products.end()) linear.weight = linear.weight + found->second;
    }
    std::map<std::string, torch::Tensor> products;
  };
  const std::vector<LoraTarget> targets = ExpertLoraTargets(config_);
  for (const LoraKind kind : {LoraKind::kPerHead, LoraKind::kPerMatrix}) {
    torch::manual_seed(6);
    std::vector<torch::Tensor> leaves;
    for (const torch::Tensor& tensor : Parameters(RandomExpertLora(config_, kind)))
      leaves.push_back(tensor.requires_grad_());
    const LoraWeights phi = FromParameters(leaves, 1);
    const PrefixContext stored =
        EncodePrefix(model_, EmbedPrefix(model_, inputs_.model), inputs_.model.state);
    const at::AutoGradMode record(true);
    Merge merge;
    for (size_t i = 0; i < targets.size(); ++i) {
      const MatrixPair pair = AsMatrices(targets[i], phi.A[i], phi.B[i]);
      merge.products[targets[i].name] = at::matmul(pair.B, pair.A);
    }
    OpenpiModel merged = model_;
    VisitParameters(config_, merged.weights, merge);
    const FlowLoss full = ComputeFlowLoss(merged, inputs_.model, inputs_.loss_actions,
                                          inputs_.loss_noise, inputs_.loss_time);
    const OpenpiModel adapted = WithLora(model_, phi);
    const torch::Tensor v =
        Velocity(adapted, SuffixOnCache(adapted, stored, full.x_t.detach(), inputs_.loss_time));
    const torch::Tensor loss = (full.u_t - v).square().mean();
    const double expected = full.mean.item<double>();
    EXPECT_NEAR(loss.item<double>(), expected, 2e-5 * expected);
    const auto by_cache = torch::autograd::grad({loss}, leaves),
               by_joint = torch::autograd::grad({full.mean}, leaves);
    for (size_t i = 0; i < leaves.size(); ++i) {
      const double largest = by_joint[i].abs().max().item<double>();
      EXPECT_LT(MaxDifference(by_cache[i], by_joint[i]), 2e-4 * largest + 1e-7) << i;
    }
  }
}

TEST_P(OpenpiNetwork, RowsWithTheirOwnAdaptersAgreeWithBatchesOfOne) {
  torch::manual_seed(7);
  const LoraWeights a = RandomExpertLora(config_, LoraKind::kPerHead),
                    b = RandomExpertLora(config_, LoraKind::kPerMatrix, 2);
  const std::vector<const LoraWeights*> rows = {&a, nullptr, &b};
  const PrefixContext shared =
      EncodePrefix(model_, EmbedPrefix(model_, inputs_.model), inputs_.model.state);
  const OpenpiModel batch = WithLora(model_, StackLora(ExpertLoraTargets(config_), rows));
  const torch::Tensor chunks = IntegrateEuler(batch, shared, inputs_.noise, 10).xs.back();
  for (int64_t i = 0; i < 3; ++i) {
    PrefixContext row;
    for (size_t layer = 0; layer < shared.cache.keys.size(); ++layer) {
      row.cache.keys.push_back(shared.cache.keys[layer].narrow(0, i, 1));
      row.cache.values.push_back(shared.cache.values[layer].narrow(0, i, 1));
    }
    row.valid = shared.valid.narrow(0, i, 1);
    row.state = shared.state.narrow(0, i, 1);
    const OpenpiModel one = rows[i] == nullptr ? model_ : WithLora(model_, *rows[i]);
    const torch::Tensor alone =
        IntegrateEuler(one, row, inputs_.noise.narrow(0, i, 1), 10).xs.back();
    // Ten steps of float32 with sums in another order.
    EXPECT_LT(MaxDifference(chunks[i], alone[0]), 1e-5 * (1 + alone.abs().max().item<double>()));
  }
  EXPECT_GT(MaxDifference(chunks, IntegrateEuler(model_, shared, inputs_.noise, 10).xs.back()),
            1e-3);
}

TEST(OpenpiFlow, EulerTimesAreSummedInSinglePrecision) {
  const torch::NoGradGuard no_grad;
  const OpenpiModel model = RandomOpenpiModel(TinyConfig(false), 5);
  const OracleInputs in = RandomInputs(model.config, 2, 2, true, 1);
  const PrefixContext context = EncodePrefix(model, EmbedPrefix(model, in.model), in.model.state);
  const EulerTrajectory euler = IntegrateEuler(model, context, in.noise, 10);
  EXPECT_THAT(euler.times,
              ::testing::ElementsAre(1.0f, 0.9f, 0.79999995f, 0.6999999f, 0.5999999f, 0.4999999f,
                                     0.39999992f, 0.29999992f, 0.19999993f, 0.09999993f));
  ASSERT_EQ(euler.xs.size(), 11u);
  const torch::Tensor v =
      Velocity(model, SuffixOnCache(model, context, euler.xs[9], at::full({2}, euler.times[9])));
  EXPECT_LT(MaxDifference(euler.xs[10], euler.xs[9] - 0.1 * v), 1e-6);
}

TEST(OpenpiFlow, TimeEmbeddingHasThePeriodsOfPi0) {
  const torch::Tensor e = EmbedTime(torch::tensor({0.0f, 1.0f}), 8);  // periods 4e-3 .. 4
  EXPECT_TRUE(at::equal(e[0], torch::tensor({0.f, 0.f, 0.f, 0.f, 1.f, 1.f, 1.f, 1.f})));
  for (int k = 0; k < 4; ++k) {
    const double angle = 2 * M_PI / (4e-3 * std::pow(1000.0, k / 3.0));
    EXPECT_NEAR(e[1][k].item<double>(), std::sin(angle), 1e-6) << k;
    EXPECT_NEAR(e[1][4 + k].item<double>(), std::cos(angle), 1e-6) << k;
  }
}

TEST(OpenpiMasks, BlocksSeeThemselvesAndWhatIsBefore) {
  const torch::Tensor valid = torch::tensor({{false, true, true, true, true}}, torch::kBool);
  const torch::Tensor starts = torch::tensor({{false, false, true, true, false}}, torch::kBool);
  const torch::Tensor expected =
      torch::tensor(
          {{{0, 0, 0, 0, 0}, {0, 1, 0, 0, 0}, {0, 1, 1, 0, 0}, {0, 1, 1, 1, 1}, {0, 1, 1, 1, 1}}},
          torch::kInt64)
          .to(torch::kBool);
  EXPECT_TRUE(at::equal(BlockMask(valid, starts), expected));
  EXPECT_TRUE(at::equal(Positions(valid), torch::tensor({{-1, 0, 1, 2, 3}}, torch::kInt64)));
  const auto suffix = [](const torch::Tensor& t) { return t.narrow(1, 2, 3); };
  const auto prefix = [](const torch::Tensor& t) { return t.narrow(1, 0, 2); };
  EXPECT_TRUE(at::equal(SuffixMask(prefix(valid), suffix(valid), suffix(starts)),
                        expected.narrow(1, 2, 3)));
  EXPECT_TRUE(at::equal(SuffixPositions(prefix(valid), suffix(valid)),
                        torch::tensor({{1, 2, 3}}, torch::kInt64)));
}

}  // namespace
}  // namespace robostress::openpi
