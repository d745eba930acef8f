#include "server/policies/nano_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <thread>

#include "adapter/compensation.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "server/policies/nano_network.h"
#include "tests/policies/tiny_nano.h"

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

std::string TempFile(const std::string& name) {
  return (std::filesystem::path(testing::TempDir()) / ("nano_policy_test_" + name)).string();
}

// ---- an independent implementation: one pass over prefix and suffix together, no cache, plain
// operators ----

Tensor PlainNorm(const Tensor& x, const Tensor& weight) {
  return x / torch::sqrt(x.square().mean(-1, true) + 1e-6) * (1.0 + weight);
}

// x [T, H, h] at integer positions [T].
Tensor PlainRope(const Tensor& x, const Tensor& position) {
  const int64_t half = x.size(-1) / 2;
  Tensor out = torch::zeros_like(x);
  for (int64_t t = 0; t < x.size(0); ++t) {
    for (int64_t j = 0; j < half; ++j) {
      const double angle =
          position[t].item<double>() *
          std::pow(10000.0, -2.0 * static_cast<double>(j) / static_cast<double>(2 * half));
      const Tensor x1 = x[t].select(-1, j), x2 = x[t].select(-1, j + half);
      out[t].select(-1, j).copy_(x1 * std::cos(angle) - x2 * std::sin(angle));
      out[t].select(-1, j + half).copy_(x2 * std::cos(angle) + x1 * std::sin(angle));
    }
  }
  return out;
}

struct JointInput {
  std::vector<Tensor> images;  // per camera [1, 3, s, s]
  Tensor words;                // [max_words]
  Tensor state;                // [state_dim]
  Tensor x;                    // [K, d]
  double u = 0;
};

// A norm by its equation: the plain one, or with scale, shift and gate from cond [w].
struct PlainNormed {
  Tensor y, gate;
};
PlainNormed AnyNorm(const Tensor& x, const NanoNorm& norm, const Tensor& cond) {
  if (!norm.dense.defined()) return {PlainNorm(x, norm.weight), torch::ones({1})};
  const auto m = (torch::matmul(norm.dense, cond) + norm.dense_bias).chunk(3, 0);
  return {PlainNorm(x, m[0]) + m[1], m[2]};
}

// The velocity by the rule of pi0: query i may see key j iff cumsum(block)[j] <= cumsum(block)[i]
// and both are valid; blocks start at the state, where it is a token, and at the first action.
Tensor JointVelocity(const NanoConfig& c, const NanoParameters& p, const JointInput& input) {
  std::vector<Tensor> prefix = {p.readout};
  for (size_t v = 0; v < p.cameras.size(); ++v) {
    Tensor y = input.images[v];
    for (size_t i = 0; i < p.cameras[v].conv_weight.size(); ++i) {
      const int64_t pad = (p.cameras[v].conv_weight[i].size(-1) - 1) / 2;
      y = torch::relu(
          torch::conv2d(y, p.cameras[v].conv_weight[i], p.cameras[v].conv_bias[i], 2, pad));
    }
    y = y[0].flatten(1).t();  // [grid^2, channels]
    prefix.push_back(torch::matmul(y, p.cameras[v].token_weight.t()) + p.cameras[v].token_bias +
                     p.cameras[v].position);
  }
  for (int j = 0; j < c.state_words(); ++j) {
    const double share = (input.state[j].item<double>() + c.state_span) / (2 * c.state_span);
    const int bin =
        std::clamp(static_cast<int>(std::floor(share * c.state_bins)), 0, c.state_bins - 1);
    prefix.push_back((p.state_words[bin] + p.state_position[j]).unsqueeze(0));
  }
  prefix.push_back(p.words.index_select(0, input.words) *
                   std::sqrt(static_cast<double>(c.prefix_width)));
  Tensor a = torch::cat(prefix);  // [P, w]

  const int64_t tokens = c.action_tokens(), e = c.expert_width;
  Tensor time = torch::zeros({e});
  for (int64_t k = 0; k < e / 2; ++k) {
    const double period =
        4e-3 * std::pow(4.0 / 4e-3, static_cast<double>(k) / static_cast<double>(e / 2 - 1));
    time[k] = std::sin(2.0 * std::numbers::pi * input.u / period);
    time[k + e / 2] = std::cos(2.0 * std::numbers::pi * input.u / period);
  }
  const Tensor action =
      torch::matmul(input.x.reshape({tokens, -1}), p.action_in_weight.t()) + p.action_in_bias;
  Tensor b = action, cond;  // [suffix tokens, e], [e]
  if (c.pi05()) {
    const Tensor hidden = torch::silu(torch::matmul(p.time_in_weight, time) + p.time_in_bias);
    cond = torch::silu(torch::matmul(p.time_out_weight, hidden) + p.time_out_bias);
  } else {
    const Tensor both = torch::cat({action, time.unsqueeze(0).expand({tokens, e})}, 1);
    const Tensor mixed = torch::silu(torch::matmul(both, p.time_in_weight.t()) + p.time_in_bias);
    const Tensor timed = torch::matmul(mixed, p.time_out_weight.t()) + p.time_out_bias;
    const Tensor state = torch::matmul(input.state.unsqueeze(0), p.state_weight.t()) + p.state_bias;
    b = torch::cat({state, timed});
  }

  const int64_t length = a.size(0) + b.size(0), first_word = a.size(0) - c.max_words;
  Tensor valid = torch::ones({length}, torch::kBool), block = torch::zeros({length}, torch::kInt64);
  valid.narrow(0, first_word, c.max_words).copy_(input.words.ne(0));
  block[a.size(0)] = 1;
  if (!c.pi05()) block[a.size(0) + 1] = 1;
  const Tensor level = block.cumsum(0), position = valid.to(torch::kInt64).cumsum(0) - 1;
  const Tensor sees = (level.unsqueeze(0) <= level.unsqueeze(1)) & valid.unsqueeze(0);

  for (int i = 0; i < c.layers; ++i) {
    const NanoLayer &la = p.prefix[i], &lb = p.expert[i];
    const bool last = i + 1 == c.layers;  // nobody reads the prefix after its last keys
    const int64_t h = c.head_dim, hq = c.heads * h;
    const PlainNormed na = AnyNorm(a, la.input_norm, cond), nb = AnyNorm(b, lb.input_norm, cond);
    const Tensor ya = torch::matmul(na.y, la.qkv_proj.t());
    const Tensor yb = torch::matmul(nb.y, lb.qkv_proj.t());
    const Tensor qa = last ? torch::zeros({a.size(0), hq}) : ya.narrow(1, 0, hq);
    const Tensor q =
        PlainRope(torch::cat({qa, yb.narrow(1, 0, hq)}).view({length, c.heads, h}), position);
    const Tensor ka = ya.narrow(1, last ? 0 : hq, h), va = ya.narrow(1, last ? h : hq + h, h);
    const Tensor k =
        PlainRope(torch::cat({ka, yb.narrow(1, hq, h)}).view({length, 1, h}), position);
    const Tensor v = torch::cat({va, yb.narrow(1, hq + h, h)});
    std::vector<Tensor> heads;
    for (int head = 0; head < c.heads; ++head) {
      const Tensor scores =
          torch::matmul(q.select(1, head), k.select(1, 0).t()) / std::sqrt(static_cast<double>(h));
      heads.push_back(torch::matmul(torch::softmax(scores.masked_fill(~sees, -1e30), -1), v));
    }
    const Tensor attended = torch::cat(heads, 1);
    const auto finish = [&](const Tensor& x, const Tensor& rows, const Tensor& gate,
                            const NanoLayer& l, int64_t mlp) {
      const Tensor mid = x + gate * torch::matmul(rows, l.o_proj.t());
      const PlainNormed n = AnyNorm(mid, l.post_norm, cond);
      const auto parts = torch::matmul(n.y, l.gate_up_proj.t()).split(mlp, -1);
      return mid + n.gate * torch::matmul(at::gelu(parts[0], "tanh") * parts[1], l.down_proj.t());
    };
    if (!last) a = finish(a, attended.narrow(0, 0, a.size(0)), na.gate, la, c.prefix_mlp);
    b = finish(b, attended.narrow(0, a.size(0), b.size(0)), nb.gate, lb, c.expert_mlp);
  }
  const Tensor out = AnyNorm(b.narrow(0, b.size(0) - tokens, tokens), p.expert_norm, cond).y;
  return (torch::matmul(out, p.action_out_weight.t()) + p.action_out_bias)
      .reshape({c.horizon, c.model_action_dim});
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

TEST(NanoWeights, SurviveARoundTrip) {
  const NanoModel model = TinyModel();
  const std::string path = TempFile("round.safetensors");
  ASSERT_TRUE(SaveNanoModel(model, path).ok());
  const NanoModel read = LoadNanoModel(path).value();
  EXPECT_EQ(read.vocabulary.words(), model.vocabulary.words());
  EXPECT_EQ(read.actions.std, model.actions.std);
  EXPECT_EQ(read.state.mean, model.state.mean);
  for (size_t i = 0; i < model.tensors.size(); ++i)
    EXPECT_TRUE(torch::equal(read.tensors[i], model.tensors[i]));
  const auto policy = LoadFlowPolicy(path).value();
  EXPECT_EQ(policy->spec().model_hash, Sha256OfFile(path).value());
  EXPECT_EQ(policy->spec().image_width, 16);
  std::filesystem::remove(path);
}

TEST(NanoWeights, ReportAllProblemsOfAFileAtOnce) {
  NanoModel model = TinyModel();
  const std::string path = TempFile("bad.safetensors");
  ASSERT_TRUE(SaveNanoModel(model, path).ok());
  const SafetensorsFile good = SafetensorsFile::Open(path).value();
  SafetensorsWriter writer;
  for (const auto& [key, value] : good.metadata()) writer.SetMetadata(key, value);
  for (const auto& [name, view] : good.tensors()) {
    if (name == "prefix.readout") continue;
    std::vector<int64_t> shape = view.shape;
    if (name == "state_proj.weight") std::swap(shape[0], shape[1]);
    writer.Add(name, view.dtype, shape, view.bytes.data(), view.bytes.size());
  }
  writer.AddFloats("extra", {1}, std::vector<float>{1.0f});
  ASSERT_TRUE(writer.Write(path).ok());
  EXPECT_THAT(
      std::string(LoadNanoModel(path).status().message()),
      AllOf(HasSubstr("3 problems"), HasSubstr("prefix.readout is missing"),
            HasSubstr("extra is unknown"),
            HasSubstr("state_proj.weight has shape [8,16], must be [16,8]"), HasSubstr(path)));

  model.tensors[0][0][0][0][0] = std::nanf("");
  ASSERT_TRUE(SaveNanoModel(model, path).ok());
  EXPECT_THAT(std::string(LoadNanoModel(path).status().message()),
              HasSubstr("cameras.0.conv.0.weight holds nan"));
  std::filesystem::remove(path);
}

TEST(NanoWeights, RefuseTruncatedForeignAndAbsentFiles) {
  const std::string path = TempFile("cut.safetensors");
  ASSERT_TRUE(SaveNanoModel(TinyModel(), path).ok());
  const std::string bytes = ReadFile(path).value();
  ASSERT_TRUE(WriteFileAtomically(path, bytes.substr(0, bytes.size() / 2)).ok());
  EXPECT_THAT(std::string(LoadFlowPolicy(path).status().message()), HasSubstr(path));
  SafetensorsWriter foreign;
  foreign.SetMetadata("format", "pt");
  foreign.AddFloats("weight", {1}, std::vector<float>{1.0f});
  ASSERT_TRUE(foreign.Write(path).ok());
  EXPECT_THAT(std::string(LoadNanoModel(path).status().message()),
              AllOf(HasSubstr("format is 'pt'"), HasSubstr("robostress-nano")));
  EXPECT_THAT(std::string(LoadFlowPolicy(path).status().message()), HasSubstr(path));
  std::filesystem::remove(path);
  EXPECT_FALSE(LoadFlowPolicy(path).ok());
  EXPECT_THAT(std::string(LoadFlowPolicy("nanno").status().message()),
              AllOf(HasSubstr("nanno"), HasSubstr("nano:random")));
}

TEST(NanoWeights, OfTheRepositoryLoadAndKnowTheirWords) {
  const std::string path =
      "server/models/weights/nano.safetensors";  // tests run in the source folder
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not there";
  EXPECT_LE(std::filesystem::file_size(path), 20u << 20);
  const auto policy = LoadFlowPolicy("nano");
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_EQ((*policy)->spec().horizon, 50);
  EXPECT_EQ((*policy)->spec().execute_steps, 5);
  EXPECT_GT(LoadNanoModel(path)->vocabulary.words().size(), 10u);
}

TEST(NanoConfig, RefusesSizesThatDoNotFit) {
  const auto message = [](auto change) {
    NanoConfig config = TinyConfig();
    change(config);
    return std::string(ValidateNanoConfig(config).message());
  };
  EXPECT_EQ(message([](NanoConfig&) {}), "");
  EXPECT_THAT(message([](NanoConfig& c) { c.steps_per_token = 3; }),
              HasSubstr("steps_per_token is 3"));
  EXPECT_THAT(message([](NanoConfig& c) { c.image_size = 18; }), HasSubstr("multiple of 2^2"));
  EXPECT_THAT(message([](NanoConfig& c) { c.layers = 0; }), HasSubstr("layers is 0"));
  EXPECT_THAT(message([](NanoConfig& c) { c.model_action_dim = 6; }),
              HasSubstr("model_action_dim is 6"));
}

TEST(Vocabulary, SplitsWordsAndPads) {
  EXPECT_THAT(SplitWords("Put the  Red-hot bowl, on_it!"),
              testing::ElementsAre("put", "the", "red-hot", "bowl", "on", "it"));
  Vocabulary vocabulary;
  vocabulary.Add("put the bowl");
  vocabulary.Add("the plate");
  EXPECT_THAT(vocabulary.words(), testing::ElementsAre("put", "the", "bowl", "plate"));
  EXPECT_THAT(vocabulary.Encode("THE plate flies", 5).value(), testing::ElementsAre(3, 5, 1, 0, 0));
}

}  // namespace
}  // namespace robostress
