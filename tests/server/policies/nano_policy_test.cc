#include "server/policies/nano/nano_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/autograd.h>
#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <thread>

#include "adapter/compensation.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "server/policies/nano/nano_network.h"
#include "tests/common/wire/heard_log.h"
#include "tests/server/policies/nano_joint_pass.h"
#include "tests/server/policies/tiny_nano.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using torch::Tensor;

constexpr NanoArchitecture kArchitectures[] = {NanoArchitecture::kPi0, NanoArchitecture::kPi05};

std::unique_ptr<FlowPolicy> TinyPolicy(uint64_t seed = 3,
                                       NanoArchitecture architecture = NanoArchitecture::kPi0) {
  return MakeNanoPolicy(TinyModel(seed, 5, architecture), "tiny").value();
}

LoraWeights SomeLora(const VelocityField& field, double b_scale,
                     LoraKind kind = LoraKind::kPerHead) {
  torch::manual_seed(8);
  LoraWeights lora;
  for (const LoraTarget& target : field.lora_targets()) {
    const LoraShape shape = LoraShapeOf(target, kind, 4);
    lora.A.push_back(torch::randn(shape.A) * 0.1);
    lora.B.push_back(torch::randn(shape.B) * b_scale);
  }
  return lora;
}

class NanoGraph : public testing::TestWithParam<std::tuple<int, NanoArchitecture>> {};

TEST_P(NanoGraph, CachedPrefixGivesTheJointPass) {
  const NanoModel model = TinyModel(5, std::get<0>(GetParam()), std::get<1>(GetParam()));
  const NanoParameters parameters = AssembleNano(model.config, model.tensors);
  const NanoNetwork network(model.config, parameters);
  torch::manual_seed(2);
  const Tensor words = torch::tensor({2, 3, 4, 5, 0, 0, 0, 0, 0}, torch::kInt64);
  JointInput input{{torch::randn({1, 3, 16, 16}), torch::randn({1, 3, 16, 16})},
                   words,
                   3 * torch::randn({8}),
                   torch::randn({model.config.horizon, 8}),
                   0.37};
  const NanoNetwork::Prefix prefix =
      network.EncodePrefix(input.images, words.unsqueeze(0), input.state.unsqueeze(0), false);
  const Tensor v =
      network.Velocity(prefix.context, input.x.unsqueeze(0), torch::tensor({0.37f}), nullptr);
  const Tensor expected = JointVelocity(model.config, parameters, input);
  // Single precision through three layers; the double precision of the test's trigonometry is the
  // larger part.
  EXPECT_LT((v[0] - expected).abs().max().item<double>(),
            2e-5 * (1.0 + expected.abs().max().item<double>()));
}

INSTANTIATE_TEST_SUITE_P(StepsPerTokenAndArchitecture, NanoGraph,
                         testing::Combine(testing::Values(1, 5),
                                          testing::Values(NanoArchitecture::kPi0,
                                                          NanoArchitecture::kPi05)));

TEST(NanoGraph, PaddingWordsHaveNoInfluence) {
  NanoModel model = TinyModel();
  const NanoConfig& config = model.config;
  const auto table = NanoTensorTable(config);
  const std::vector<Tensor> images = {torch::randn({1, 3, 16, 16}), torch::randn({1, 3, 16, 16})};
  const Tensor words = torch::tensor({{2, 3, 4, 0, 0, 0, 0, 0, 0}}, torch::kInt64),
               x = torch::randn({1, 10, 8});
  const auto velocity = [&](const Tensor& rows) {
    const NanoNetwork network(config, AssembleNano(config, model.tensors));
    const NanoNetwork::Prefix prefix =
        network.EncodePrefix(images, rows, torch::ones({1, 8}), false);
    return network.Velocity(prefix.context, x, torch::tensor({0.5f}), nullptr);
  };
  const Tensor before = velocity(words);
  const Tensor trimmed = velocity(words.narrow(1, 0, 3).contiguous());
  EXPECT_TRUE(torch::allclose(before, trimmed, 1e-5, 1e-5));
  for (size_t i = 0; i < table.size(); ++i) {
    if (table[i].name == "prefix.words") model.tensors[i][0].fill_(7.0f);  // the padding row
  }
  EXPECT_TRUE(torch::equal(velocity(words), before));
}

TEST(NanoGraph, ChunksThatShareAContextRowEqualRepeatedRows) {
  const NanoModel model = TinyModel();
  const NanoNetwork network(model.config, AssembleNano(model.config, model.tensors));
  const std::vector<Tensor> images = {torch::randn({2, 3, 16, 16}), torch::randn({2, 3, 16, 16})};
  const Tensor words = torch::tensor({{2, 3, 4, 0, 0}, {5, 6, 2, 3, 4}}, torch::kInt64);
  const PolicyContext context =
      network.EncodePrefix(images, words, torch::randn({2, 8}), false).context;
  const Tensor x = torch::randn({6, 10, 8}), u = torch::rand({6});
  const Tensor shared = network.Velocity(context, x, u, nullptr);
  std::vector<PolicyContext> rows;
  for (int64_t i : {0, 0, 0, 1, 1, 1}) {
    PolicyContext row;
    for (size_t layer = 0; layer < context.keys.size(); ++layer) {
      row.keys.push_back(context.keys[layer].narrow(0, i, 1));
      row.values.push_back(context.values[layer].narrow(0, i, 1));
    }
    row.prefix_mask = context.prefix_mask.narrow(0, i, 1);
    row.state = context.state.narrow(0, i, 1);
    rows.push_back(row);
  }
  for (int64_t i = 0; i < 6; ++i) {
    const Tensor alone = network.Velocity(rows[i], x.narrow(0, i, 1), u.narrow(0, i, 1), nullptr);
    EXPECT_TRUE(torch::allclose(alone[0], shared[i], 1e-5, 1e-5)) << i;
  }
}

TEST(NanoTime, EmbeddingFollowsPi0) {
  const Tensor embedding = TimeEmbedding(torch::tensor({0.0f, 0.3f, 1.0f}), 8);
  const double times[] = {0.0, static_cast<double>(0.3f), 1.0};
  for (int row = 0; row < 3; ++row) {
    for (int k = 0; k < 4; ++k) {
      const double period = 4e-3 * std::pow(1000.0, k / 3.0),
                   angle = 2.0 * std::numbers::pi * times[row] / period;
      EXPECT_NEAR(embedding[row][k].item<float>(), std::sin(angle), 1e-6);
      EXPECT_NEAR(embedding[row][4 + k].item<float>(), std::cos(angle), 1e-6);
    }
  }
}

TEST(NanoTime, EulerTimesAccumulateInSinglePrecision) {
  const std::vector<float> times = EulerTimes(10);
  ASSERT_EQ(times.size(), 10u);
  float t = 1.0f;
  for (const float time : times) {
    EXPECT_EQ(time, t);
    t += -0.1f;
  }
  EXPECT_NE(times[9], 0.1f);  // the sum of roundings, as in the reference, not k / 10
}

TEST(NanoLora, CoversSevenProjectionsOfEveryExpertLayer) {
  const auto policy = TinyPolicy();
  const auto& targets = policy->lora_targets();
  ASSERT_EQ(targets.size(), 7u * 3u);
  EXPECT_EQ(targets[0].name, "layers.0.q_proj");
  EXPECT_EQ(targets[20].name, "layers.2.down_proj");
  EXPECT_EQ(targets[20].in_features, 24);
  EXPECT_EQ(targets[20].out_features, 16);
}

TEST(NanoLora, HasTheCountsOfBothKinds) {
  const std::vector<LoraTarget> targets = NanoLoraTargets(NanoConfig());
  // q and o: 4 heads of 32 in and out of 128; k and v; gate and up; down: rank 4, four layers.
  EXPECT_EQ(NumLoraParameters(targets, LoraKind::kPerHead, 4),
            4 * 4 * (2 * 4 * (128 + 32) + 2 * (128 + 32) + 3 * (128 + 384)));
  EXPECT_EQ(NumLoraParameters(targets, LoraKind::kPerMatrix, 4),
            4 * 4 * (2 * (128 + 128) + 2 * (128 + 32) + 3 * (128 + 384)));
}

TEST(NanoLora, HasNoEffectAtAllWhileBIsZero) {
  const auto policy = TinyPolicy();
  const PolicyContext context = policy->Encode(TinyObservation(policy->spec())).value();
  const Tensor noise = torch::randn({1, 10, 8});
  const LoraWeights lora = SomeLora(*policy, 0.0);
  EXPECT_TRUE(
      torch::equal(policy->Sample(context, noise, &lora), policy->Sample(context, noise, nullptr)));
}

class NanoLoraKinds : public testing::TestWithParam<LoraKind> {};
INSTANTIATE_TEST_SUITE_P(Kinds, NanoLoraKinds,
                         testing::Values(LoraKind::kPerHead, LoraKind::kPerMatrix));

TEST_P(NanoLoraKinds, EveryTargetActsAsItsMergedWeight) {
  NanoModel model = TinyModel();
  const auto policy = MakeNanoPolicy(TinyModel(), "tiny").value();
  const LoraWeights lora = SomeLora(*policy, 0.1, GetParam());
  const auto table = NanoTensorTable(model.config);
  const std::map<std::string, std::vector<size_t>> parts = {
      {"qkv_proj", {0, 1, 2}}, {"o_proj", {3}}, {"gate_up_proj", {4, 5}}, {"down_proj", {6}}};
  for (size_t i = 0; i < table.size(); ++i) {
    for (int layer = 0; layer < 3; ++layer) {
      for (const auto& [name, targets] : parts) {
        if (table[i].name != "expert.layers." + std::to_string(layer) + "." + name + ".weight")
          continue;
        std::vector<Tensor> deltas;
        for (const size_t target : targets) {
          const size_t at = layer * 7 + target;
          const MatrixPair pair = AsMatrices(policy->lora_targets()[at], lora.A[at], lora.B[at]);
          deltas.push_back(torch::matmul(pair.B, pair.A));
        }
        model.tensors[i] = model.tensors[i] + torch::cat(deltas);
      }
    }
  }
  const auto merged = MakeNanoPolicy(std::move(model), "merged").value();
  const PolicyContext context = policy->Encode(TinyObservation(policy->spec())).value();
  const Tensor x = torch::randn({1, 10, 8}), u = torch::tensor({0.4f});
  const Tensor with = policy->Velocity(context, x, u, &lora);
  EXPECT_TRUE(torch::allclose(with, merged->Velocity(context, x, u, nullptr), 1e-4, 1e-4));
  EXPECT_FALSE(torch::allclose(with, policy->Velocity(context, x, u, nullptr), 1e-3, 1e-3));
}

// Expert weights with the adapter added, differentiable in it.
NanoParameters Merged(const NanoConfig& config, NanoParameters p, const LoraWeights& lora) {
  const std::vector<LoraTarget> targets = NanoLoraTargets(config);
  const auto product = [&](int layer, int target) {
    const size_t at = layer * 7 + target;
    const MatrixPair pair = AsMatrices(targets[at], lora.A[at], lora.B[at]);
    return torch::matmul(pair.B, pair.A);
  };
  for (int i = 0; i < config.layers; ++i) {
    NanoLayer& layer = p.expert[i];
    layer.qkv_proj = layer.qkv_proj + torch::cat({product(i, 0), product(i, 1), product(i, 2)});
    layer.o_proj = layer.o_proj + product(i, 3);
    layer.gate_up_proj = layer.gate_up_proj + torch::cat({product(i, 4), product(i, 5)});
    layer.down_proj = layer.down_proj + product(i, 6);
  }
  return p;
}

TEST_P(NanoLoraKinds, LossAndGradientsOnStoredPrefixesAreThoseOfTheFullComputation) {
  const NanoModel model = TinyModel(5);
  const NanoConfig& config = model.config;
  const NanoParameters parameters = AssembleNano(config, model.tensors);
  const NanoNetwork network(config, parameters);
  const auto policy = MakeNanoPolicy(TinyModel(5), "tiny").value();
  torch::manual_seed(4);
  std::vector<JointInput> inputs;
  std::vector<PolicyContext> stored;
  std::vector<Tensor> targets;
  for (int i = 0; i < 4; ++i) {
    Tensor words = torch::zeros({9}, torch::kInt64);
    words.narrow(0, 0, 2 + i).fill_(2 + i);
    inputs.push_back({{torch::randn({1, 3, 16, 16}), torch::randn({1, 3, 16, 16})},
                      words,
                      torch::randn({8}),
                      {},
                      0});
    torch::NoGradGuard no_grad;
    stored.push_back(
        network
            .EncodePrefix(inputs[i].images, words.unsqueeze(0), inputs[i].state.unsqueeze(0), false)
            .context);
    targets.push_back(torch::randn({config.horizon, config.model_action_dim}));
  }
  const LoraWeights phi_0 =
      InitialLora(policy->lora_targets(), GetParam(), 4, 0.05, StreamKey("phi_0"));
  std::vector<Tensor> leaves;
  for (const Tensor& tensor : Parameters(SomeLora(*policy, 0.1, GetParam())))
    leaves.push_back(tensor.requires_grad_());
  const LoraWeights phi = FromParameters(leaves, 1);
  const FlowDraw draw = DrawFlow(StreamKey("draw"), 0, config.horizon, config.model_action_dim);

  const Tensor loss =
      CompensationLoss(*policy, StackContexts({&stored[0], &stored[1], &stored[2], &stored[3]}),
                       torch::stack(targets), draw, phi, phi_0, 1e-2);
  const NanoParameters merged = Merged(config, parameters, phi);
  Tensor full = torch::zeros({});
  for (int i = 0; i < 4; ++i) {
    inputs[i].x = draw.u * draw.eps + (1 - draw.u) * targets[i];
    inputs[i].u = static_cast<double>(static_cast<float>(draw.u));
    const Tensor v = JointVelocity(config, merged, inputs[i]);
    full = full + (v - (draw.eps - targets[i])).square().mean() / 4;
  }
  for (size_t i = 0; i < leaves.size(); ++i)
    full = full + 1e-2 * (leaves[i] - Parameters(phi_0)[i]).square().sum();
  EXPECT_NEAR(loss.item<double>(), full.item<double>(), 1e-5 * full.item<double>());
  const std::vector<Tensor> got = torch::autograd::grad({loss}, leaves),
                            expected = torch::autograd::grad({full}, leaves);
  for (size_t i = 0; i < leaves.size(); ++i) {
    const double largest = expected[i].abs().max().item<double>();
    EXPECT_GT(largest, 1e-5);
    EXPECT_LT((got[i] - expected[i]).abs().max().item<double>(), 1e-4 * largest + 1e-7) << i;
  }
}

TEST(NanoLora, RowsWithTheirOwnAdaptersHaveTheBitsOfBatchesOfOne) {
  const auto policy = TinyPolicy();
  const LoraWeights a = SomeLora(*policy, 0.1), b = SomeLora(*policy, 0.2, LoraKind::kPerMatrix);
  const std::vector<const LoraWeights*> lora = {&a, nullptr, &b, &a};
  std::vector<PolicyContext> contexts;
  std::vector<const PolicyContext*> pointers;
  for (int i = 0; i < 4; ++i)  // the last two rows share a prefix
    contexts.push_back(policy->Encode(TinyObservation(policy->spec(), std::min(i, 2))).value());
  for (const PolicyContext& context : contexts) pointers.push_back(&context);
  const PolicyContext batch = StackContexts(pointers);
  const Tensor noise = torch::randn({4, 10, 8});
  const Tensor chunks = policy->SampleRows(batch, noise, lora);
  const Tensor by_default = policy->FlowPolicy::SampleRows(batch, noise, lora);
  for (int i = 0; i < 4; ++i) {
    const Tensor alone = policy->Sample(contexts[i], noise.narrow(0, i, 1), lora[i]);
    EXPECT_TRUE(torch::equal(chunks[i], alone[0])) << i;
    EXPECT_TRUE(torch::equal(by_default[i], alone[0])) << i;
  }
  EXPECT_FALSE(torch::allclose(chunks[2], chunks[3], 1e-2, 1e-2));
}

TEST(NanoLora, VelocityIsDifferentiableInTheAdapterAndInNothingElse) {
  const auto policy = TinyPolicy();
  const PolicyContext context = policy->Encode(TinyObservation(policy->spec())).value();
  for (const Tensor& key : context.keys) EXPECT_FALSE(key.requires_grad());
  const Tensor x = torch::randn({1, 10, 8}), u = torch::tensor({0.4f});
  EXPECT_FALSE(policy->Velocity(context, x, u, nullptr).requires_grad());
  LoraWeights lora = SomeLora(*policy, 0.1);
  for (size_t i = 0; i < lora.A.size(); ++i) {
    lora.A[i].set_requires_grad(true);
    lora.B[i].set_requires_grad(true);
  }
  const Tensor direction = torch::randn({1, 10, 8});
  const auto value = [&] { return (policy->Velocity(context, x, u, &lora) * direction).sum(); };
  value().backward();
  torch::NoGradGuard no_grad;
  for (size_t i = 0; i < lora.A.size(); ++i) {
    for (Tensor* parameter : {&lora.A[i], &lora.B[i]}) {
      ASSERT_TRUE(parameter->grad().defined()) << policy->lora_targets()[i].name;
      // Central difference along the gradient; single precision allows three digits.
      const Tensor step = parameter->grad() / parameter->grad().norm() * 1e-2;
      const double slope = parameter->grad().norm().item<double>();
      parameter->add_(step);
      const double up = value().item<double>();
      parameter->sub_(2.0 * step);
      const double down = value().item<double>();
      parameter->add_(step);
      EXPECT_NEAR((up - down) / 2e-2, slope, 0.03 * slope + 2e-3) << policy->lora_targets()[i].name;
    }
  }
}

class NanoSampling : public testing::TestWithParam<NanoArchitecture> {};
INSTANTIATE_TEST_SUITE_P(Architecture, NanoSampling, testing::ValuesIn(kArchitectures));

TEST_P(NanoSampling, IsDeterministicAndFollowsTheVelocity) {
  const auto policy = TinyPolicy(3, GetParam());
  const PolicyContext context = policy->Encode(TinyObservation(policy->spec())).value();
  const Tensor noise = torch::randn({1, 10, 8});
  const LoraWeights lora = SomeLora(*policy, 0.1);
  for (const LoraWeights* weights : {static_cast<const LoraWeights*>(nullptr), &lora}) {
    const Tensor chunk = policy->Sample(context, noise, weights);
    EXPECT_TRUE(torch::equal(chunk, policy->Sample(context, noise, weights)));
    Tensor x = noise.clone();
    float t = 1.0f;
    for (int i = 0; i < 10; ++i, t -= 0.1f)
      x = x - 0.1f * policy->Velocity(context, x, torch::tensor({t}), weights);
    // The sampler's own arithmetic against LibTorch's operators: ten steps of single precision.
    EXPECT_TRUE(torch::allclose(chunk, x, 2e-5, 2e-5)) << (chunk - x).abs().max();
  }
}

TEST_P(NanoSampling, RowsOfABatchHaveTheBitsOfSinglePredictions) {
  const auto policy = TinyPolicy(3, GetParam());
  std::vector<PolicyContext> contexts;
  for (int i = 0; i < 3; ++i)
    contexts.push_back(policy->Encode(TinyObservation(policy->spec(), i)).value());
  PolicyContext batch;
  for (size_t layer = 0; layer < contexts[0].keys.size(); ++layer) {
    batch.keys.push_back(
        torch::cat({contexts[0].keys[layer], contexts[1].keys[layer], contexts[2].keys[layer]}));
    batch.values.push_back(torch::cat(
        {contexts[0].values[layer], contexts[1].values[layer], contexts[2].values[layer]}));
  }
  batch.prefix_mask =
      torch::cat({contexts[0].prefix_mask, contexts[1].prefix_mask, contexts[2].prefix_mask});
  batch.state = torch::cat({contexts[0].state, contexts[1].state, contexts[2].state});
  const Tensor noise = torch::randn({3, 10, 8});
  const Tensor together = policy->Sample(batch, noise, nullptr);
  for (int i = 0; i < 3; ++i) {
    const Tensor alone = policy->Sample(contexts[i], noise.narrow(0, i, 1), nullptr);
    EXPECT_TRUE(torch::equal(together[i], alone[0])) << i;
  }
}

TEST(NanoPolicy, ThreadsPredictTheSameBitsAtOnce) {
  const auto policy = TinyPolicy();
  const Observation observation = TinyObservation(policy->spec());
  const Tensor noise = torch::randn({1, 10, 8});
  const Tensor expected = policy->Sample(policy->Encode(observation).value(), noise, nullptr);
  std::vector<int> same(4, 0);
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&, i] {
      for (int k = 0; k < 5; ++k) {
        same[i] += torch::equal(policy->Sample(policy->Encode(observation).value(), noise, nullptr),
                                expected);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_THAT(same, testing::Each(5));
}

TEST(NanoPolicy, ActionTransformsAreInverse) {
  const auto policy = TinyPolicy();
  const Eigen::MatrixXf actions = Eigen::MatrixXf::Random(10, 7);
  const Tensor model = policy->ToModel(actions, {});
  EXPECT_EQ(model.size(1), 7);
  EXPECT_NEAR(model[2][3].item<float>(), (actions(2, 3) - 0.15f) / (0.6f + 1e-6f), 1e-6);
  const Tensor padded = torch::cat({model, torch::full({10, 1}, 9.0f)}, 1);
  EXPECT_LT((policy->ToEnvironment(padded, {}) - actions).cwiseAbs().maxCoeff(), 1e-6);
}

TEST(NanoPolicy, RefusesObservationsThatItWasNotTrainedOn) {
  const auto policy = TinyPolicy();
  const auto message = [&](auto change) {
    Observation observation = TinyObservation(policy->spec());
    change(observation);
    return std::string(policy->Encode(observation).status().message());
  };
  EXPECT_THAT(message([](Observation& o) {
                o.views[0].image = {8, 8, std::vector<uint8_t>(192)};
              }),
              AllOf(HasSubstr("8 x 8"), HasSubstr("16 x 16"), HasSubstr("agentview")));
  EXPECT_THAT(message([](Observation& o) { o.views[1].image.data.pop_back(); }),
              HasSubstr("767 bytes"));
  EXPECT_THAT(message([](Observation& o) { o.views[1].camera = "side"; }),
              AllOf(HasSubstr("robot0_eye_in_hand"), HasSubstr("side")));
  EXPECT_THAT(message([](Observation& o) { o.proprioception.conservativeResize(7); }),
              HasSubstr("7 numbers"));
  EXPECT_THAT(message([](Observation& o) { o.proprioception[2] = std::nanf(""); }),
              HasSubstr("proprioception[2]"));
  EXPECT_THAT(message([](Observation& o) { o.instruction = " ?! "; }), HasSubstr("no words"));
  EXPECT_THAT(message([](Observation& o) { o.instruction = "a b c d e f g h i j"; }),
              HasSubstr("10 words"));
  EXPECT_EQ(message([](Observation&) {}), "");
}

TEST(NanoPolicy, TellsOnceWhichWordsOfAnInstructionItNeverLearned) {
  const auto policy = TinyPolicy();
  Observation observation = TinyObservation(policy->spec());
  const HeardLog log;
  ASSERT_TRUE(policy->Encode(observation).ok());
  EXPECT_EQ(log.words(), "");
  observation.instruction.insert(0, "Yank\n");
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(policy->Encode(observation).ok());
  const std::string said = log.words();
  EXPECT_THAT(said, HasSubstr("never learned these words of 'yank put the red bowl on the plate'"));
  EXPECT_THAT(said, HasSubstr("all are one to it: yank\n"));
  EXPECT_EQ(std::count(said.begin(), said.end(), '\n'), 1) << said;
}

// What the last executed step of a chunk should be does not depend on where the chunk began; how
// the network sees it does (paper, sec:supp_real).
TEST(NanoPolicy, ActionsThatAreDisplacementsAreCountedFromTheStateOfTheirPrediction) {
  NanoModel model = TinyModel();
  const NanoModel absolute = model;
  model.config.displacement_channels = 6;
  const auto policy = MakeNanoPolicy(model, "tiny").value();
  const auto plain = MakeNanoPolicy(absolute, "tiny").value();
  const Observation observation = TinyObservation(policy->spec());
  const auto context = policy->Encode(observation);
  ASSERT_TRUE(context.ok()) << context.status();
  torch::manual_seed(4);
  const Tensor chunk = torch::randn({10, 8});
  const Eigen::MatrixXf actions = policy->ToEnvironment(chunk, context->state);
  const Eigen::MatrixXf counted = plain->ToEnvironment(chunk, context->state);
  for (int j = 0; j < 7; ++j) {
    const float origin = j < 6 ? observation.proprioception[j] : 0.0f;
    for (int i = 0; i < 10; ++i) EXPECT_NEAR(actions(i, j), origin + counted(i, j), 1e-5);
  }
  const Tensor back = policy->ToModel(actions, context->state);
  EXPECT_LT((back - chunk.narrow(1, 0, 7)).abs().max().item<float>(), 1e-5f);
}

}  // namespace
}  // namespace robostress
