#include "adapter/lora_adapter.h"

#include <gtest/gtest.h>

#include <cmath>

#include "adapter/compensation.h"
#include "tests/adapter/fake_policy.h"

namespace robostress {
namespace {

LoraOptions Ours(double learning_rate = 1e-3) { return LoraOptions::At(learning_rate); }

std::shared_ptr<const TrainingChunk> Chunk(const FakePolicy& policy, int index) {
  auto chunk = std::make_shared<TrainingChunk>();
  chunk->context = *policy.Encode(FakePolicy::MakeObservation(index));
  chunk->target = FakePolicy::Random("target" + std::to_string(index),
                                     {FakePolicy::kHorizon, FakePolicy::kDim}, 1);
  return chunk;
}

std::vector<std::shared_ptr<const TrainingChunk>> Batch(const FakePolicy& policy, int first) {
  std::vector<std::shared_ptr<const TrainingChunk>> batch;
  for (int i = first; i < first + 4; ++i) batch.push_back(Chunk(policy, i));
  return batch;
}

std::unique_ptr<LoraAdapter> Make(const FakePolicy& policy, const LoraOptions& options,
                                  const std::string& session = "s") {
  return *LoraAdapter::Create(&policy, options, StreamKey("session").With(session));
}

TEST(InitialLora, HasGaussianAAndZeroB) {
  const std::vector<LoraTarget> targets{{"a", 500, 20}, {"b", 500, 20}};
  const LoraWeights lora = InitialLora(targets, LoraKind::kPerMatrix, 4, 0.01, StreamKey("s"));
  EXPECT_NEAR(lora.A[0].std().item<double>(), 0.01,
              0.0007);  // 2000 draws: 2.2 standard errors are 0.00035
  EXPECT_NEAR(lora.A[0].mean().item<double>(), 0, 0.001);
  EXPECT_EQ(lora.B[0].abs().max().item<float>(), 0);
  EXPECT_FALSE(lora.A[0].equal(lora.A[1]));
  EXPECT_EQ(NumParameters(lora), 2 * 4 * 520);
}

TEST(InitialLora, DependsOnTheSessionAndTheTargetsNameNotOnItsPlace) {
  const LoraWeights ab =
      InitialLora({{"a", 5, 2}, {"b", 5, 2}}, LoraKind::kPerMatrix, 4, 0.01, StreamKey("s"));
  const LoraWeights ba =
      InitialLora({{"b", 5, 2}, {"a", 5, 2}}, LoraKind::kPerMatrix, 4, 0.01, StreamKey("s"));
  EXPECT_TRUE(BitEqual(ab.A[0], ba.A[1]));
  EXPECT_FALSE(BitEqual(
      ab.A[0], InitialLora({{"a", 5, 2}}, LoraKind::kPerMatrix, 4, 0.01, StreamKey("other")).A[0]));
}

TEST(LoraAdapter, PredictsWhatTheBasePolicyPredictsBeforeTheFirstUpdateBitForBit) {
  const FakePolicy policy;
  const auto adapter = Make(policy, Ours());
  const PolicyContext context = *policy.Encode(FakePolicy::MakeObservation(0));
  const torch::Tensor noise =
      FakePolicy::Random("noise", {1, FakePolicy::kHorizon, FakePolicy::kDim}, 1);
  EXPECT_TRUE(BitEqual(policy.Sample(context, noise, adapter->snapshot().get()),
                       policy.Sample(context, noise, nullptr)));
}

TEST(LoraAdapter, PublishesNewWeightsAndNeverWritesOldOnes) {
  const FakePolicy policy;
  const auto adapter = Make(policy, Ours());
  const auto before = adapter->snapshot();
  const torch::Tensor B = before->B[0].clone();
  const auto report = adapter->Update(0, Batch(policy, 0));
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_TRUE(report->applied);
  EXPECT_EQ(report->version, 1u);
  EXPECT_TRUE(BitEqual(before->B[0], B));
  EXPECT_EQ(before->version, 0u);
  EXPECT_FALSE(adapter->snapshot()->B[0].equal(B));
  EXPECT_GT(adapter->distance(), 0);
  EXPECT_FALSE(adapter->snapshot()->B[0].requires_grad());
}

TEST(LoraAdapter, FirstStepIsTheLearningRateTimesTheSignOfTheGradient) {
  // At B = 0 the gradient of A vanishes, so A stays; Adam's first step is lr g / (|g| + eps).
  const FakePolicy policy;
  const auto adapter = Make(policy, Ours(1e-3));
  ASSERT_TRUE(adapter->Update(0, Batch(policy, 0)).ok());
  EXPECT_TRUE(BitEqual(adapter->snapshot()->A[0], adapter->phi_0().A[0]));
  EXPECT_NEAR(adapter->snapshot()->B[1].abs().max().item<double>(), 1e-3, 1e-6);
}

TEST(LoraAdapter, IsAPureFunctionOfItsBatchesAndIndices) {
  const FakePolicy policy;
  const auto a = Make(policy, Ours()), b = Make(policy, Ours());
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(a->Update(i, Batch(policy, i)).ok());
    ASSERT_TRUE(b->Update(i, Batch(policy, i)).ok());
  }
  EXPECT_TRUE(BitEqual(*a->snapshot(), *b->snapshot()));
  const auto c = Make(policy, Ours());
  ASSERT_TRUE(c->Update(7, Batch(policy, 0)).ok());
  const auto d = Make(policy, Ours());
  ASSERT_TRUE(d->Update(0, Batch(policy, 0)).ok());
  EXPECT_FALSE(BitEqual(*c->snapshot(), *d->snapshot()));  // another index, other (u, eps)
}

TEST(LoraAdapter, ReducesTheLossOnItsOwnTargets) {
  const FakePolicy policy;
  LoraOptions options = Ours(1e-2);
  const auto adapter = Make(policy, options);
  const auto batch = Batch(policy, 0);
  const auto mean_loss = [&] {
    double sum = 0;
    for (int i = 0; i < 40; ++i) {
      std::vector<const PolicyContext*> contexts;
      std::vector<torch::Tensor> targets;
      for (const auto& chunk : batch) {
        contexts.push_back(&chunk->context);
        targets.push_back(chunk->target);
      }
      sum += CompensationLoss(
                 policy, StackContexts(contexts), torch::stack(targets),
                 DrawFlow(StreamKey("validation"), i, FakePolicy::kHorizon, FakePolicy::kDim),
                 *adapter->snapshot(), adapter->phi_0(), 0)
                 .item<double>();
    }
    return sum / 40;
  };
  const double before = mean_loss();
  for (int i = 0; i < 200; ++i) ASSERT_TRUE(adapter->Update(i, batch).ok());
  EXPECT_LT(mean_loss(), 0.8 * before);
}

TEST(LoraAdapter, AnchorHoldsTheWeightsNearTheirStart) {
  const FakePolicy policy;
  LoraOptions held = Ours(1e-2), loose = Ours(1e-2);
  held.anchor_weight = 1.0;
  loose.anchor_weight = 0;
  const auto a = Make(policy, held), b = Make(policy, loose);
  for (int i = 0; i < 100; ++i) {
    ASSERT_TRUE(a->Update(i, Batch(policy, 0)).ok());
    ASSERT_TRUE(b->Update(i, Batch(policy, 0)).ok());
  }
  EXPECT_LT(a->distance(), 0.5 * b->distance());
}

TEST(LoraAdapter, RefusesAnUpdateThatIsNotFiniteAndStaysAsItWas) {
  const FakePolicy policy;
  const auto adapter = Make(policy, Ours());
  ASSERT_TRUE(adapter->Update(0, Batch(policy, 0)).ok());
  const auto before = adapter->snapshot();
  auto bad = std::make_shared<TrainingChunk>(*Chunk(policy, 1));
  bad->target = bad->target.clone().fill_(std::nanf(""));
  const auto report = adapter->Update(1, {bad, bad, bad, bad});
  ASSERT_TRUE(report.ok());
  EXPECT_FALSE(report->applied);
  EXPECT_EQ(adapter->snapshot(), before);
  EXPECT_EQ(adapter->Export().adam.steps, 1);
}

TEST(LoraAdapter, RollsBackToAVersionItStillHolds) {
  const FakePolicy policy;
  const auto adapter = Make(policy, Ours());
  std::vector<std::shared_ptr<const LoraWeights>> versions{adapter->snapshot()};
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(adapter->Update(i, Batch(policy, i)).ok());
    versions.push_back(adapter->snapshot());
  }
  ASSERT_TRUE(adapter->Rollback(15).ok());
  EXPECT_TRUE(BitEqual(*adapter->snapshot(), *versions[15]));
  EXPECT_EQ(adapter->Export().adam.steps, 0);
  EXPECT_EQ(adapter->Rollback(17).code(), absl::StatusCode::kNotFound);  // its future is gone
  EXPECT_EQ(adapter->Rollback(1).code(), absl::StatusCode::kNotFound);   // too old
  ASSERT_TRUE(adapter->Rollback(0).ok());
  EXPECT_TRUE(BitEqual(*adapter->snapshot(), *versions[0]));
  EXPECT_EQ(adapter->distance(), 0);
}

TEST(LoraAdapter, FirstMomentsAreTheBetasShareOfTheGradient) {
  // From rest m = (1 - beta1) g and v = (1 - beta2) g^2, so v (1 - beta1)^2 = m^2 (1 - beta2).
  const FakePolicy policy;
  LoraOptions method = Ours(1e-3);
  method.beta1 = 0.8;
  method.beta2 = 0.99;
  const auto adapter = Make(policy, method);
  ASSERT_TRUE(adapter->Update(0, Batch(policy, 0)).ok());
  const AdamState adam = adapter->Export().adam;
  double largest = 0;
  for (size_t i = 0; i < adam.m.size(); ++i) {
    const torch::Tensor m = adam.m[i].to(torch::kFloat64), v = adam.v[i].to(torch::kFloat64);
    const torch::Tensor g2 = m.square() / (0.2 * 0.2);
    largest = std::max(largest, g2.max().item<double>());
    EXPECT_TRUE(torch::allclose(v / 0.01, g2, 1e-4, 1e-12)) << i;
  }
  EXPECT_GT(largest, 1e-8) << "a gradient that is not zero";
}

TEST(LoraAdapter, ClipsTheGradientsNormToTheMethods) {
  // Adam's first moment after a step is a tenth of what is left of the gradient.
  const FakePolicy policy;
  LoraOptions method = Ours(1e-3);
  method.clip_norm = 1e-4;
  const auto adapter = Make(policy, method);
  ASSERT_TRUE(adapter->Update(0, Batch(policy, 0)).ok());
  double squares = 0;
  for (const torch::Tensor& m : adapter->Export().adam.m)
    squares += m.square().sum().item<double>();
  EXPECT_NEAR(std::sqrt(squares), 0.1 * 1e-4, 1e-9);
}

TEST(UpdateGuard, RefusesWhatRaisesTheLossOrGoesTooFarAndTheAdapterObeys) {
  const FakePolicy policy;
  const StreamKey session("guard");
  const auto adapter = Make(policy, Ours(0.3));  // a step that does harm elsewhere
  UpdateContext context;
  context.guard.enabled = true;
  context.guard.max_loss_ratio = 1e9;
  context.held_out = Batch(policy, 20);
  const auto report = adapter->Update(0, Batch(policy, 0), context);
  ASSERT_TRUE(report.ok() && report->applied && report->verdict);
  const double ratio = report->verdict->candidate_loss / report->verdict->published_loss;
  const double distance = report->verdict->candidate_distance;
  EXPECT_NEAR(distance, adapter->distance(), 1e-9);
  for (const double factor : {0.99, 1.01}) {
    const auto by_loss = Make(policy, Ours(0.3)), by_distance = Make(policy, Ours(0.3));
    UpdateContext other = context;
    other.guard.max_loss_ratio = factor * ratio;
    EXPECT_EQ(by_loss->Update(0, Batch(policy, 0), other)->applied, factor > 1) << ratio;
    other = context;
    other.guard.max_distance = factor * distance;
    EXPECT_EQ(by_distance->Update(0, Batch(policy, 0), other)->applied, factor > 1);
    EXPECT_EQ(by_distance->snapshot()->version, factor > 1 ? 1u : 0u);
  }
}

}  // namespace
}  // namespace robostress
