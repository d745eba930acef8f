// Fast predictions against the reference of flow.h.

#include "server/policies/openpi/openpi_inference.h"

#include <ATen/Parallel.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <malloc.h>
#include <torch/types.h>

#include <cmath>
#include <thread>
#include <tuple>

#include "adapter/lora.h"
#include "server/policies/openpi/compute_threads.h"
#include "server/policies/openpi/openpi_lora.h"
#include "tests/server/policies/tiny_openpi.h"

namespace robostress::openpi {
namespace {

using ::testing::HasSubstr;
using Activations = InferenceOptions::Activations;

double MaxDifference(const torch::Tensor& a, const torch::Tensor& b) {
  return (a - b).abs().max().item<double>();
}

torch::Tensor ReferenceActions(const OpenpiModel& model, const OracleInputs& in) {
  const PrefixContext context = EncodePrefix(model, EmbedPrefix(model, in.model), in.model.state);
  return IntegrateEuler(model, context, in.noise, 10).xs.back();
}

std::unique_ptr<OpenpiInference> Prepare(const OpenpiModel& model,
                                         const InferenceOptions& options = {}) {
  auto inference = OpenpiInference::Create(model, options);
  EXPECT_TRUE(inference.ok()) << inference.status();
  return std::move(inference).value();
}

torch::Tensor FastActions(const OpenpiInference& inference, const OracleInputs& in,
                          const LoraWeights* lora = nullptr) {
  const auto context = inference.Encode(in.model);
  EXPECT_TRUE(context.ok()) << context.status();
  const auto actions = inference.Sample(*context, in.noise, lora);
  EXPECT_TRUE(actions.ok()) << actions.status();
  return *actions;
}

// Row `b` of a batch as a batch of one.
OracleInputs Row(const OracleInputs& in, int64_t b) {
  OracleInputs row = in;
  for (torch::Tensor& image : row.model.images) image = image.narrow(0, b, 1);
  for (torch::Tensor& mask : row.model.image_masks) mask = mask.narrow(0, b, 1);
  row.model.tokens = in.model.tokens.narrow(0, b, 1);
  row.model.token_mask = in.model.token_mask.narrow(0, b, 1);
  row.model.state = in.model.state.narrow(0, b, 1);
  row.noise = in.noise.narrow(0, b, 1);
  return row;
}

LoraWeights RandomAdapter(const OpenpiInference& inference, LoraKind kind = LoraKind::kPerMatrix,
                          int64_t rank = 3, uint64_t seed = 4) {
  torch::manual_seed(seed);
  LoraWeights lora;
  for (const LoraTarget& target : inference.lora_targets()) {
    const LoraShape shape = LoraShapeOf(target, kind, rank);
    lora.A.push_back(at::randn(shape.A) * 0.3);
    lora.B.push_back(at::randn(shape.B) * 0.2);
  }
  return lora;
}

// pi05, key heads, padded, device. One key head is the case of every published network.
class Inference : public ::testing::TestWithParam<std::tuple<bool, int, bool, std::string>> {
 protected:
  Inference() {
    config_.kv_heads = std::get<1>(GetParam());
    model_ = RandomOpenpiModel(config_, 5);
    inputs_ = RandomInputs(config_, 3, 3, std::get<2>(GetParam()), 11);
  }
  std::unique_ptr<OpenpiInference> OnDevice(const OpenpiModel& model,
                                            InferenceOptions options = {}) const {
    options.device = std::get<3>(GetParam());
    return Prepare(model, options);
  }
  OpenpiConfig config_ = TinyConfig(std::get<0>(GetParam()));
  OpenpiModel model_;
  OracleInputs inputs_;
  torch::NoGradGuard no_grad_;
};

INSTANTIATE_TEST_SUITE_P(Models, Inference,
                         ::testing::Combine(::testing::Bool(), ::testing::Values(1, 2),
                                            ::testing::Bool(), ::testing::ValuesIn(Devices())));

// Sums of at most 60 float32 terms in another order, through ten steps.
constexpr double kRounding = 2e-5;

TEST_P(Inference, ActionsEqualTheReference) {
  const torch::Tensor expected = ReferenceActions(model_, inputs_);
  EXPECT_GT(MaxDifference(expected, inputs_.noise), 0.1);
  EXPECT_LT(MaxDifference(FastActions(*OnDevice(model_), inputs_), expected), kRounding);
}

TEST_P(Inference, BatchEqualsItsRowsAlone) {
  const auto inference = OnDevice(model_);
  const torch::Tensor together = FastActions(*inference, inputs_);
  for (int64_t b = 0; b < 3; ++b) {
    EXPECT_LT(MaxDifference(FastActions(*inference, Row(inputs_, b)), together.narrow(0, b, 1)),
              1e-5);
  }
}

TEST_P(Inference, AdapterEqualsTheReferenceThatCarriesIt) {
  const auto inference = OnDevice(model_);
  for (const LoraKind kind : {LoraKind::kPerMatrix, LoraKind::kPerHead}) {
    const LoraWeights lora = RandomAdapter(*inference, kind);
    const OpenpiModel adapted = WithLora(model_, lora);
    const torch::Tensor expected = ReferenceActions(adapted, inputs_);
    EXPECT_GT(MaxDifference(expected, ReferenceActions(model_, inputs_)), 1e-2);
    EXPECT_LT(MaxDifference(FastActions(*inference, inputs_, &lora), expected), 5e-5);
    EXPECT_LT(MaxDifference(FastActions(*OnDevice(adapted), inputs_), expected), 5e-5);
  }
}

TEST_P(Inference, RowsOfOneBatchHaveTheirOwnAdapters) {
  const auto inference = OnDevice(model_);
  const LoraWeights first = RandomAdapter(*inference, LoraKind::kPerHead, 2, 7);
  const LoraWeights last = RandomAdapter(*inference, LoraKind::kPerMatrix, 5, 8);
  const std::vector<const LoraWeights*> lora = {&first, nullptr, &last};
  const PolicyContext context = inference->Encode(inputs_.model).value();
  const torch::Tensor together = inference->SampleRows(context, inputs_.noise, lora).value();
  for (int64_t b = 0; b < 3; ++b) {
    EXPECT_LT(
        MaxDifference(FastActions(*inference, Row(inputs_, b), lora[b]), together.narrow(0, b, 1)),
        1e-5);
  }
}

TEST_P(Inference, PrefixesOfDifferentLengthsThatWereEncodedAloneShareABatch) {
  const auto inference = OnDevice(model_);
  const LoraWeights first = RandomAdapter(*inference, LoraKind::kPerHead, 2, 7);
  const std::vector<const LoraWeights*> lora = {&first, nullptr, &first};
  std::vector<PolicyContext> alone;
  for (int64_t b = 0; b < 3; ++b) alone.push_back(inference->Encode(Row(inputs_, b).model).value());
  if (std::get<2>(GetParam())) {  // padded: only valid tokens are encoded
    EXPECT_NE(alone[0].prefix_mask.size(1), alone[2].prefix_mask.size(1));
  }
  const PolicyContext stacked = StackContexts({&alone[0], &alone[1], &alone[2]});
  const torch::Tensor together = inference->SampleRows(stacked, inputs_.noise, lora).value();
  for (int64_t b = 0; b < 3; ++b) {
    EXPECT_LT(
        MaxDifference(FastActions(*inference, Row(inputs_, b), lora[b]), together.narrow(0, b, 1)),
        1e-5);
  }
}

// On a GPU the steps are a recorded graph with buffers of its own.
TEST_P(Inference, PredictionsOfManyThreadsAreTheirOwn) {
  const auto inference = OnDevice(model_);
  const LoraWeights lora = RandomAdapter(*inference);
  std::vector<torch::Tensor> expected, actions(12);
  for (int64_t i = 0; i < 6; ++i)
    expected.push_back(FastActions(*inference, Row(inputs_, i % 3), i < 3 ? nullptr : &lora));
  std::vector<std::thread> threads;
  for (int64_t i = 0; i < 12; ++i)
    threads.emplace_back([&, i] {
      actions[i] = FastActions(*inference, Row(inputs_, i % 3), i % 6 < 3 ? nullptr : &lora);
    });
  for (std::thread& thread : threads) thread.join();
  for (int64_t i = 0; i < 12; ++i) EXPECT_LT(MaxDifference(actions[i], expected[i % 6]), 1e-5) << i;
}

TEST_P(Inference, AdapterWithZeroBChangesNothing) {
  const auto inference = OnDevice(model_);
  LoraWeights lora = RandomAdapter(*inference);
  for (torch::Tensor& B : lora.B) B.zero_();
  EXPECT_TRUE(at::equal(FastActions(*inference, inputs_, &lora), FastActions(*inference, inputs_)));
}

TEST_P(Inference, ContextIsOnlyReadAndServesTheReferenceToo) {
  const auto inference = OnDevice(model_);
  const PolicyContext context = inference->Encode(inputs_.model).value();
  const torch::Tensor first = inference->Sample(context, inputs_.noise, nullptr).value();
  EXPECT_TRUE(at::equal(inference->Sample(context, inputs_.noise, nullptr).value(), first));
  PrefixContext reference = {{{}, {}}, context.prefix_mask.cpu(), context.state.cpu(), {}};
  for (size_t i = 0; i < context.keys.size(); ++i) {
    reference.cache.keys.push_back(context.keys[i].cpu());
    reference.cache.values.push_back(context.values[i].cpu());
  }
  EXPECT_LT(MaxDifference(IntegrateEuler(model_, reference, inputs_.noise, 10).xs.back(), first),
            kRounding);
}

TEST_P(Inference, StackedContextsOfAnyLengthsEqualTheirRowsAlone) {
  const auto inference = OnDevice(model_);
  std::vector<PolicyContext> contexts;
  for (int64_t b = 0; b < 3; ++b)
    contexts.push_back(inference->Encode(Row(inputs_, b).model).value());
  const PolicyContext stacked = StackContexts({&contexts[0], &contexts[1], &contexts[2]});
  const torch::Tensor together = inference->Sample(stacked, inputs_.noise, nullptr).value();
  for (int64_t b = 0; b < 3; ++b) {
    EXPECT_LT(MaxDifference(FastActions(*inference, Row(inputs_, b)), together.narrow(0, b, 1)),
              1e-5);
  }
}

TEST_P(Inference, PrefixHoldsOnlyWhatIsValid) {
  const PolicyContext context = OnDevice(model_)->Encode(inputs_.model).value();
  int64_t longest = 0;
  for (int64_t b = 0; b < 3; ++b) {
    int64_t length = inputs_.model.token_mask[b].sum().item<int64_t>();
    for (const torch::Tensor& mask : inputs_.model.image_masks)
      length += mask[b].item<bool>() ? config_.patches() : 0;
    EXPECT_EQ(context.prefix_mask[b].sum().item<int64_t>(), length);
    longest = std::max(longest, length);
  }
  EXPECT_EQ(context.prefix_mask.size(1), longest);
}

// rms of the difference from float32 in actions of order one. Measured: 0.002-0.009 with bfloat16
// between the layers, 0.001-0.007 with widened weights.
constexpr double kBf16Rms = 0.02;

TEST_P(Inference, Bf16IsNearFloat32) {
  const torch::Tensor exact = FastActions(*OnDevice(model_), inputs_);
  for (const Activations activations : {Activations::kFloat32, Activations::kBf16}) {
    const InferenceOptions options = {.precision = Precision::kBf16,
                                      .device = std::get<3>(GetParam()),
                                      .activations = activations};
    if (options.device != "cpu" && activations == Activations::kFloat32) {
      EXPECT_THAT(OpenpiInference::Create(model_, options).status().message(),
                  HasSubstr("leave the activations automatic"));
      continue;
    }
    const auto inference = Prepare(model_, options);
    EXPECT_EQ(inference->Encode(inputs_.model)->keys[0].scalar_type(), torch::kBFloat16);
    const double rms =
        std::sqrt((FastActions(*inference, inputs_) - exact).square().mean().item<double>());
    EXPECT_GT(rms, 1e-5);  // it is bfloat16 indeed
    EXPECT_LT(rms, kBf16Rms);
  }
}

TEST(OpenpiInference, WidenedWeightsAreTheRoundedOnes) {
  const torch::NoGradGuard no_grad;
  OpenpiConfig config = TinyConfig(false);
  config.kv_heads = 1;
  const OpenpiModel model = RandomOpenpiModel(config, 5);
  const OracleInputs in = RandomInputs(config, 2, 2, true, 3);
  // Rounded to bfloat16 and back, then computed in float32: only stored keys and values differ.
  const OpenpiModel rounded =
      ConvertModel(ConvertModel(model, {torch::kBFloat16, torch::kFloat32}, torch::kCPU),
                   {torch::kFloat32, torch::kFloat32}, torch::kCPU);
  const auto widened =
      Prepare(model, {.precision = Precision::kBf16, .activations = Activations::kFloat32});
  PolicyContext context = Prepare(rounded)->Encode(in.model).value();
  const torch::Tensor expected = Prepare(rounded)->Sample(context, in.noise, nullptr).value();
  EXPECT_LT(MaxDifference(widened->Sample(context, in.noise, nullptr).value(), expected), 1e-5);
}

TEST(OpenpiInference, ManyPredictionsTakeNoMoreMemoryThanOne) {
  OpenpiConfig config = TinyConfig(true);
  config.kv_heads = 1;
  const auto inference = Prepare(RandomOpenpiModel(config, 5));
  const OracleInputs in = RandomInputs(config, 2, 2, true, 3);
  const auto used = [&](int predictions) {
    for (int i = 0; i < predictions; ++i) FastActions(*inference, in);
    return mallinfo2().uordblks;
  };
  const size_t after_warm_up = used(3);
  EXPECT_LT(used(20), after_warm_up + 64 * 1024);
}

TEST(OpenpiInference, ThreadsReachLibTorchAndTheBlas) {
  SetComputeThreads(2);
  EXPECT_EQ(at::get_num_threads(), 2);
  const int blas = BlasThreads();
  SetComputeThreads(1);
  EXPECT_EQ(at::get_num_threads(), 1);
  if (blas == 0) GTEST_SKIP() << "the BLAS is not OpenBLAS";
  EXPECT_EQ(blas, 2);
  EXPECT_EQ(BlasThreads(), 1);
}

class BadInput : public ::testing::Test {
 protected:
  BadInput() : inference_(Prepare(RandomOpenpiModel(TinyConfig(false), 5))) {}
  std::string EncodeError() {
    return std::string(inference_->Encode(in_.model).status().message());
  }
  std::string SampleError(const PolicyContext& context, const torch::Tensor& noise,
                          const LoraWeights* lora = nullptr) {
    return std::string(inference_->Sample(context, noise, lora).status().message());
  }
  std::unique_ptr<OpenpiInference> inference_;
  OracleInputs in_ = RandomInputs(TinyConfig(false), 2, 2, false, 3);
};

TEST_F(BadInput, InputsThatDoNotFitAreRefused) {
  const ModelInputs good = in_.model;
  in_.model.tokens[1][2] = 31;
  EXPECT_THAT(EncodeError(), HasSubstr("tokens hold 31, must be in [0, 31)"));
  in_.model = good;
  in_.model.tokens = good.tokens.clone().fill_(1);
  in_.model.images[1] = good.images[1].narrow(2, 0, 14);
  EXPECT_THAT(EncodeError(), HasSubstr("image 1 is [2, 3, 14, 15], must be [2, 3, 15, 15]"));
  in_.model.images[1] = good.images[1];
  in_.model.state = good.state.narrow(1, 0, 4);
  EXPECT_THAT(EncodeError(), HasSubstr("state is [2, 4], must be [2, 10]"));
  in_.model.state = good.state;
  in_.model.token_mask = at::zeros_like(good.token_mask);
  in_.model.image_masks = {at::zeros({2}, torch::kBool), torch::tensor({true, false})};
  EXPECT_THAT(EncodeError(), HasSubstr("row 1 has neither a camera nor a prompt token"));
}

TEST_F(BadInput, ContextNoiseAndAdapterThatDoNotFitAreRefused) {
  const PolicyContext context = inference_->Encode(in_.model).value();
  EXPECT_THAT(SampleError(context, in_.noise.narrow(1, 0, 6)),
              HasSubstr("noise is [2, 6, 10], must be [2, 7, 10]"));
  EXPECT_THAT(SampleError(context, in_.noise.narrow(0, 0, 1)), HasSubstr("must be [1, 29]"));
  PolicyContext broken = context;
  broken.values[2] = context.values[2].narrow(2, 0, 5);
  EXPECT_THAT(SampleError(broken, in_.noise), HasSubstr("layer 2 is [2, 2, 5, 8]"));
  LoraWeights lora = RandomAdapter(*inference_);
  lora.B[3] = at::zeros({16, 2});
  EXPECT_THAT(SampleError(context, in_.noise, &lora),
              HasSubstr("layers.0.self_attn.o_proj is [16, 2], must be [16, 3]"));
  lora.A.pop_back();
  EXPECT_THAT(SampleError(context, in_.noise, &lora), HasSubstr("must have 21 of each"));
  const auto rows = inference_->SampleRows(context, in_.noise, {nullptr});
  EXPECT_THAT(rows.status().message(), HasSubstr("1 adapters for 2 rows, must be equal"));
}

TEST_F(BadInput, DevicesAndStepsThatDoNotExistAreRefused) {
  const OpenpiModel model = RandomOpenpiModel(TinyConfig(false), 5);
  const auto message = [&](const InferenceOptions& options) {
    return std::string(OpenpiInference::Create(model, options).status().message());
  };
  EXPECT_THAT(message({.device = "tpu"}), HasSubstr("device 'tpu' must be cpu, cuda or cuda:N"));
  EXPECT_THAT(message({.device = "cuda:99"}), HasSubstr("device 'cuda:99' is not there"));
  EXPECT_THAT(message({.steps = 0}), HasSubstr("steps is 0, must be in [1, 1000]"));
}

}  // namespace
}  // namespace robostress::openpi
