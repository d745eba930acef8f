#include "adapter/adam.h"

#include <gtest/gtest.h>
#include <torch/types.h>

#include <cmath>
#include <vector>

#include "common/random.h"

namespace robostress {
namespace {

// Adam for one number, written from the paper's algorithm 1, in double.
struct ScalarAdam {
  double lr, p, m = 0, v = 0;
  int t = 0;
  void Step(double g) {
    ++t;
    m = 0.9 * m + 0.1 * g;
    v = 0.999 * v + 0.001 * g * g;
    const double m_hat = m / (1 - std::pow(0.9, t));
    const double v_hat = v / (1 - std::pow(0.999, t));
    p -= lr * m_hat / (std::sqrt(v_hat) + 1e-8);
  }
};

TEST(Adam, AgreesWithAScalarImplementation) {
  const AdamOptions options{.learning_rate = 0.01};
  RandomStream stream(StreamKey("adam_test"));
  std::vector<torch::Tensor> parameters{torch::tensor({0.5, -1.0}, torch::kFloat64),
                                        torch::tensor({2.0}, torch::kFloat64)};
  std::vector<ScalarAdam> reference{{0.01, 0.5}, {0.01, -1.0}, {0.01, 2.0}};
  AdamState state = InitialAdamState(parameters);
  for (int step = 0; step < 50; ++step) {
    // Scales from 1e-6 to 1e2: the first steps of Adam do not depend on it, epsilon does.
    const double g[] = {1e-6 * stream.Normal(), stream.Normal(), 1e2 * stream.Normal()};
    parameters = AdamStep(
        options, parameters,
        {torch::tensor({g[0], g[1]}, torch::kFloat64), torch::tensor({g[2]}, torch::kFloat64)},
        state);
    for (int i = 0; i < 3; ++i) reference[i].Step(g[i]);
  }
  EXPECT_EQ(state.steps, 50);
  EXPECT_NEAR(parameters[0][0].item<double>(), reference[0].p, 1e-12);
  EXPECT_NEAR(parameters[0][1].item<double>(), reference[1].p, 1e-12);
  EXPECT_NEAR(parameters[1][0].item<double>(), reference[2].p, 1e-12);
}

TEST(Adam, LeavesItsInputsAlone) {
  const torch::Tensor p = torch::ones({3});
  const torch::Tensor p_before = p.clone();
  AdamState state = InitialAdamState({p});
  const AdamState before = state;
  AdamStep({.learning_rate = 0.1}, {p}, {torch::ones({3})}, state);
  EXPECT_TRUE(p.equal(p_before));
  EXPECT_TRUE(before.m[0].equal(torch::zeros({3})));  // a published moment is never written again
}

TEST(Adam, AtLearningRateZeroChangesNoBit) {
  const torch::Tensor p = torch::tensor({0.1f, -3e-5f, 0.0f});
  AdamState state = InitialAdamState({p});
  const auto after =
      AdamStep({.learning_rate = 0}, {p}, {torch::tensor({1.0f, -2.0f, 0.0f})}, state);
  EXPECT_TRUE(after[0].equal(p));
}

TEST(ClipGlobalNorm, ScalesAllGradientsTogether) {
  std::vector<torch::Tensor> gradients{torch::tensor({3.0f}), torch::tensor({0.0f, 4.0f})};
  EXPECT_DOUBLE_EQ(ClipGlobalNorm(gradients, 1.0), 5.0);
  EXPECT_NEAR(gradients[0][0].item<double>(), 0.6, 1e-7);
  EXPECT_NEAR(gradients[1][1].item<double>(), 0.8, 1e-7);
}

TEST(ClipGlobalNorm, LeavesSmallGradientsAlone) {
  std::vector<torch::Tensor> gradients{torch::tensor({0.3f, 0.4f})};
  EXPECT_NEAR(ClipGlobalNorm(gradients, 1.0), 0.5, 1e-7);
  EXPECT_TRUE(gradients[0].equal(torch::tensor({0.3f, 0.4f})));
}

}  // namespace
}  // namespace robostress
