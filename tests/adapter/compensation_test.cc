#include "adapter/compensation.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/adapter/fake_policy.h"

namespace robostress {
namespace {

constexpr int64_t kK = FakePolicy::kHorizon, kD = FakePolicy::kDim;

TEST(TargetChunk, CorrectsExecutedRowsOnlyAndKeepsGripperAndPaddingBitForBit) {
  const torch::Tensor raw = FakePolicy::Random("raw", {kK, kD}, 1);
  const torch::Tensor corrected = FakePolicy::Random("corrected", {3, 7}, 1);
  const torch::Tensor target = TargetChunk(raw, 2, corrected);
  for (int64_t i = 0; i < kK; ++i) {
    for (int64_t j = 0; j < kD; ++j) {
      const bool executed = i >= 2 && i < 5 && j < 6;
      const float expected = executed ? corrected[i - 2][j].item<float>() : raw[i][j].item<float>();
      EXPECT_EQ(target[i][j].item<float>(), expected) << i << ", " << j;
    }
  }
}

TEST(DrawFlow, IsAFunctionOfSessionAndUpdateAlone) {
  const StreamKey session = StreamKey("session").With("a");
  const FlowDraw first = DrawFlow(session, 3, kK, kD), again = DrawFlow(session, 3, kK, kD);
  EXPECT_EQ(first.u, again.u);
  EXPECT_TRUE(BitEqual(first.eps, again.eps));
  EXPECT_NE(first.u, DrawFlow(session, 4, kK, kD).u);
  EXPECT_NE(first.u, DrawFlow(StreamKey("session").With("b"), 3, kK, kD).u);
}

TEST(DrawFlow, TimeIsUniformNotTheTrainingsBeta) {
  // 2000 draws of Uniform(0, 1): mean 0.5 +- 0.0065, variance 1/12. Training's Beta(1.5, 1) has
  // mean 0.6.
  double sum = 0, sum_sq = 0;
  for (int i = 0; i < 2000; ++i) {
    const double u = DrawFlow(StreamKey("s"), i, 1, 1).u;
    sum += u;
    sum_sq += u * u;
  }
  EXPECT_NEAR(sum / 2000, 0.5, 0.026);
  EXPECT_NEAR(sum_sq / 2000 - 0.25, 1.0 / 12, 0.03);
}

class Loss : public ::testing::Test {
 protected:
  Loss() {
    const auto f64 = torch::kFloat64;
    for (int i = 0; i < 2; ++i)
      contexts_.push_back(*policy_.Encode(FakePolicy::MakeObservation(i)));
    context_ = StackContexts({&contexts_[0], &contexts_[1]});
    targets_ = FakePolicy::Random("targets", {2, kK, kD}, 1).to(f64);
    draw_ = DrawFlow(StreamKey("loss"), 0, kK, kD);
    draw_.eps = draw_.eps.to(f64);
    phi_0_ = InitialLora(policy_.lora_targets(), LoraKind::kPerHead, 4, 0.3, StreamKey("phi_0"));
    std::vector<torch::Tensor> parameters;
    int index = 0;
    for (const torch::Tensor& p : Parameters(phi_0_)) {
      parameters.push_back(
          (p + FakePolicy::Random("move" + std::to_string(index++), p.sizes().vec(), 0.3)).to(f64));
    }
    phi_ = FromParameters(parameters, 0);
    phi_0_ = FromParameters(
        {phi_0_.A[0].to(f64), phi_0_.B[0].to(f64), phi_0_.A[1].to(f64), phi_0_.B[1].to(f64)}, 0);
  }

  double Value(const LoraWeights& phi, double anchor) const {
    return CompensationLoss(policy_, context_, targets_, draw_, phi, phi_0_, anchor).item<double>();
  }

  FakePolicy policy_;
  std::vector<PolicyContext> contexts_;
  PolicyContext context_;
  torch::Tensor targets_;
  FlowDraw draw_;
  LoraWeights phi_, phi_0_;
};

TEST_F(Loss, IsTheMeanOverKAndDPlusTheAnchorAsASum) {
  // Written out with loops, from the equation.
  const double lambda = 0.01;
  double expected = 0;
  for (int b = 0; b < 2; ++b) {
    torch::Tensor x = torch::empty({1, kK, kD}, torch::kFloat64);
    for (int64_t i = 0; i < kK; ++i) {
      for (int64_t j = 0; j < kD; ++j) {
        x[0][i][j] = draw_.u * draw_.eps[i][j].item<double>() +
                     (1 - draw_.u) * targets_[b][i][j].item<double>();
      }
    }
    const torch::Tensor v =
        policy_.Velocity(contexts_[b], x, torch::full({1}, draw_.u, torch::kFloat64), &phi_)[0];
    double sum = 0;
    for (int64_t i = 0; i < kK; ++i) {
      for (int64_t j = 0; j < kD; ++j) {
        const double error = v[i][j].item<double>() -
                             (draw_.eps[i][j].item<double>() - targets_[b][i][j].item<double>());
        sum += error * error;
      }
    }
    expected += sum / (kK * kD) / 2;
  }
  const double distance = LoraDistance(phi_, phi_0_);
  EXPECT_NEAR(Value(phi_, lambda), expected + lambda * distance * distance, 1e-10);
  EXPECT_NEAR(Value(phi_, 0), expected, 1e-10);
}

TEST_F(Loss, GradientAgreesWithFiniteDifferences) {
  const double lambda = 0.05, h = 1e-6;
  std::vector<torch::Tensor> leaves;
  for (const torch::Tensor& p : Parameters(phi_)) leaves.push_back(p.clone().requires_grad_(true));
  const torch::Tensor loss = CompensationLoss(policy_, context_, targets_, draw_,
                                              FromParameters(leaves, 0), phi_0_, lambda);
  const std::vector<torch::Tensor> gradients = torch::autograd::grad({loss}, leaves);
  for (size_t i = 0; i < leaves.size(); ++i) {
    for (const int64_t k : {int64_t{0}, leaves[i].numel() / 2, leaves[i].numel() - 1}) {
      const auto moved = [&](double by) {
        std::vector<torch::Tensor> parameters;
        for (const torch::Tensor& p : Parameters(phi_)) parameters.push_back(p.clone());
        parameters[i].view(-1)[k] += by;
        return Value(FromParameters(parameters, 0), lambda);
      };
      // Central differences in double: error of order h^2 plus 1e-16 / h.
      EXPECT_NEAR(gradients[i].view(-1)[k].item<double>(), (moved(h) - moved(-h)) / (2 * h), 1e-7)
          << i << ", " << k;
    }
  }
}

TEST_F(Loss, OfABatchIsTheMeanOfItsMembersWithTheSameDraw) {
  double sum = 0;
  for (int b = 0; b < 2; ++b) {
    sum += CompensationLoss(policy_, contexts_[b], targets_.narrow(0, b, 1), draw_, phi_, phi_0_, 0)
               .item<double>();
  }
  EXPECT_NEAR(Value(phi_, 0), sum / 2, 1e-10);
}

}  // namespace
}  // namespace robostress
