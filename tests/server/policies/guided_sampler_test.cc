#include "server/policies/guided_sampler.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "server/policies/nano/nano_policy.h"
#include "tests/adapter/fake_policy.h"
#include "tests/server/policies/tiny_nano.h"

namespace robostress {
namespace {

using torch::Tensor;

// The exact velocity of data that are N(0, s^2) in every entry: a_hat = k(u) x.
class GaussianField : public VelocityField {
 public:
  static constexpr int64_t kRows = 6, kDims = 2;
  static constexpr double kStd = 0.7;
  static double Shrink(double u) {
    const double s2 = kStd * kStd;
    return (1 - u) * s2 / (u * u + (1 - u) * (1 - u) * s2);
  }
  int64_t horizon() const override { return kRows; }
  int64_t model_action_dim() const override { return kDims; }
  const std::vector<LoraTarget>& lora_targets() const override { return targets_; }
  ContextShape context_shape() const override { return {}; }
  Tensor Velocity(const PolicyContext&, const Tensor& x, const Tensor& u,
                  const LoraWeights*) const override {
    const double time = u.item<double>();
    return x * ((1 - Shrink(time)) / time);
  }

 private:
  std::vector<LoraTarget> targets_;
};

TEST(SoftMaskTest, HoldsThenGuidesLessAndLessThenNotAtAll) {
  const Tensor mask = SoftMask(2, 5, 8);
  ASSERT_EQ(mask.size(0), 8);
  const auto at = [&](int64_t i) { return mask[i].item<double>(); };
  EXPECT_EQ(at(0), 1);
  EXPECT_EQ(at(1), 1);
  for (int i = 2; i < 5; ++i) {
    const double c = (5.0 - i) / 4;
    EXPECT_NEAR(at(i), c * std::expm1(c) / std::expm1(1), 1e-6) << i;
  }
  for (int i = 5; i < 8; ++i) EXPECT_EQ(at(i), 0) << i;
  EXPECT_EQ(SoftMask(0, 0, 3).sum().item<double>(), 0);
  EXPECT_EQ(SoftMask(3, 3, 3).sum().item<double>(), 3);
}

TEST(GuidedSamplerTest, FollowsTheFormulaStepByStep) {
  const GaussianField field;
  torch::manual_seed(4);
  const Tensor noise = torch::randn({1, 6, 2}, torch::kFloat64), Y = torch::randn({6, 2}),
               W = torch::rand({6, 2});
  const std::vector<float> times = {1.0f, 0.75f, 0.5f, 0.25f};
  for (const double beta : {1.5, 5.0, 100.0}) {
    const Tensor x = SampleGuided(field, {}, noise, nullptr, times, {Y, W, beta});
    for (int64_t i = 0; i < 6; ++i) {
      for (int64_t j = 0; j < 2; ++j) {
        double value = noise[0][i][j].item<double>();
        const double y = Y[i][j].item<double>(), w = W[i][j].item<double>();
        for (const double u : {1.0, 0.75, 0.5, 0.25}) {
          const double k = GaussianField::Shrink(u), a_hat = k * value;
          // tau = 1 - u: (1 - tau) / (tau r^2), r^2 = (1 - tau)^2 / (tau^2 + (1 - tau)^2).
          const double tau = 1 - u, r2 = u * u / (tau * tau + u * u);
          const double guidance = tau == 0 ? beta : std::min(beta, u / (tau * r2));
          value += 0.25 * (-(value - a_hat) / u + guidance * k * w * (y - a_hat));
        }
        EXPECT_NEAR(x[0][i][j].item<double>(), value, 1e-9) << beta << " " << i << " " << j;
      }
    }
  }
}

TEST(GuidedSamplerTest, GuidesByTheGradientThroughTheNetwork) {
  const FakePolicy policy;
  const PolicyContext context = policy.Encode(FakePolicy::MakeObservation(1)).value();
  torch::manual_seed(6);
  const auto like = torch::TensorOptions(torch::kFloat64);
  const Tensor x = torch::randn({1, FakePolicy::kHorizon, FakePolicy::kDim}, like);
  const Tensor Y = torch::randn({FakePolicy::kHorizon, FakePolicy::kDim}, like);
  const Tensor W = torch::rand({FakePolicy::kHorizon, FakePolicy::kDim}, like);
  const auto velocity = [&](const Tensor& at) {
    return policy.Velocity(context, at, torch::full({1}, 0.5, like), nullptr);
  };
  // One step at u = 1/2: w = 2, x' = x - v + 2 g.
  const Tensor next = SampleGuided(policy, context, x, nullptr, {0.5f}, {Y, W});
  const Tensor g = (next - x + velocity(x)) / 2;
  const auto error = [&](const Tensor& at) {
    return (0.5 * W * (Y - (at - 0.5 * velocity(at))[0]).square()).sum().item<double>();
  };
  constexpr double kStep = 1e-5;
  for (const auto& [i, j] : {std::pair<int64_t, int64_t>{0, 0}, {3, 5}, {9, 7}}) {
    Tensor up = x.clone(), down = x.clone();
    up[0][i][j] += kStep;
    down[0][i][j] -= kStep;
    EXPECT_NEAR(g[0][i][j].item<double>(), -(error(up) - error(down)) / (2 * kStep), 1e-6)
        << i << " " << j;
  }
  EXPECT_FALSE(next.requires_grad());
}

TEST(GuidedSamplerTest, WithoutWeightItIsTheUnguidedSample) {
  for (const NanoArchitecture architecture : {NanoArchitecture::kPi0, NanoArchitecture::kPi05}) {
    const auto policy = MakeNanoPolicy(TinyModel(3, 5, architecture), "tiny").value();
    const PolicyContext context = policy->Encode(TinyObservation(policy->spec())).value();
    torch::manual_seed(9);
    const Tensor noise = torch::randn({1, 10, 8});
    const Tensor guided = SampleGuided(*policy, context, noise, nullptr, EulerTimes(10),
                                       {torch::ones({10, 8}), torch::zeros({10, 8})});
    EXPECT_LT((guided - policy->Sample(context, noise, nullptr)).abs().max().item<double>(), 1e-4);
  }
}

Observation InpaintScene(const FlowPolicy& policy, int seed) {
  Observation observation = TinyObservation(policy.spec(), seed);
  observation.instruction = "put the bottle on the rack";
  observation.proprioception.setZero();
  return observation;
}

// The embedded weights: what was held is what the next chunk begins with.
TEST(InpaintTest, ReproducesTheRowsThatAreHeld) {
  const auto policy = LoadFlowPolicy("nano");
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->spec().inpaints);
  const int dim = (*policy)->spec().action_dim;
  double guided_error = 0, plain_error = 0;
  for (int seed = 0; seed < 4; ++seed) {
    const PolicyContext context = (*policy)->Encode(InpaintScene(**policy, seed)).value();
    torch::manual_seed(20 + seed);
    const Tensor first = torch::randn({1, 50, 8}), second = torch::randn({1, 50, 8});
    const Eigen::MatrixXf running =
        (*policy)->ToEnvironment((*policy)->Sample(context, first, nullptr)[0], context.state);
    RunningRows rows;
    rows.actions = running.bottomRows(45);
    rows.held = 6;
    const PolicyContext next = (*policy)->Encode(InpaintScene(**policy, seed + 1)).value();
    const auto error = [&](const Tensor& chunk) {
      return ((*policy)->ToEnvironment(chunk[0], next.state).topRows(6) - rows.actions.topRows(6))
          .leftCols(dim)
          .cwiseAbs()
          .mean();
    };
    guided_error += error((*policy)->Inpaint(next, second, nullptr, rows)) / 4;
    plain_error += error((*policy)->Sample(next, second, nullptr)) / 4;
  }
  RecordProperty("guided_error", std::to_string(guided_error));
  RecordProperty("plain_error", std::to_string(plain_error));
  EXPECT_LT(guided_error, 0.02) << plain_error;
  EXPECT_LT(guided_error, 0.2 * plain_error);
}

TEST(InpaintTest, DisplacementsAreCountedFromTheStateOfTheNewPrediction) {
  NanoModel model = TinyModel();
  model.config.displacement_channels = 3;
  const auto policy = MakeNanoPolicy(model, "tiny").value();
  Observation observation = TinyObservation(policy->spec());
  const PolicyContext context = policy->Encode(observation).value();
  torch::manual_seed(1);
  const Tensor noise = torch::randn({1, 10, 8});
  RunningRows running;
  running.actions = Eigen::MatrixXf::Random(6, 7);
  running.held = 2;
  const Tensor expected_rows = policy->ToModel(running.actions, context.state);
  Guidance guidance{torch::zeros({10, 8}), torch::zeros({10, 8})};
  guidance.rows.narrow(0, 0, 6).narrow(1, 0, 7).copy_(expected_rows);
  guidance.weight.narrow(1, 0, 7).copy_(SoftMask(2, 6, 10).unsqueeze(1).expand({10, 7}));
  EXPECT_TRUE(
      torch::equal(policy->Inpaint(context, noise, nullptr, running),
                   SampleGuided(*policy, context, noise, nullptr, EulerTimes(10), guidance)));
}

TEST(InpaintTest, IsTheSameEveryTimeAndLeavesNoGradientBehind) {
  const auto policy = MakeNanoPolicy(TinyModel(), "tiny").value();
  const PolicyContext context = policy->Encode(TinyObservation(policy->spec())).value();
  torch::manual_seed(1);
  const Tensor noise = torch::randn({1, 10, 8});
  RunningRows running;
  running.actions = Eigen::MatrixXf::Constant(4, 7, 0.3f);
  running.held = 4;
  const torch::NoGradGuard no_grad;  // as in the server's threads
  const Tensor a = policy->Inpaint(context, noise, nullptr, running);
  EXPECT_TRUE(torch::equal(a, policy->Inpaint(context, noise, nullptr, running)));
  EXPECT_FALSE(a.requires_grad());
}

TEST(InpaintTest, APolicyThatDoesNotThrows) {
  const FakePolicy policy;
  const PolicyContext context = policy.Encode(FakePolicy::MakeObservation(1)).value();
  EXPECT_THROW(policy.Inpaint(context, torch::zeros({1, 10, 8}), nullptr, {}), std::exception);
}

}  // namespace
}  // namespace robostress
