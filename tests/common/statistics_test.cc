#include "common/statistics.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>

#include "gtest/gtest.h"

namespace robostress {
namespace {

constexpr double kZ = 1.959963984540054;

// Output of a Python script with SciPy, or empty when there is none.
std::string SciPy(const std::string& script) {
  const std::string command = "/usr/bin/python3 -c \"" + script + "\" 2>/dev/null";
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(popen(command.c_str(), "r"), pclose);
  std::string text;
  char buffer[256];
  while (pipe != nullptr && std::fgets(buffer, sizeof(buffer), pipe.get()) != nullptr)
    text += buffer;
  return text;
}

TEST(WilsonInterval, EndsSolveTheScoreEquation) {
  // The ends p are where the score test rejects: (p_hat - p)^2 = z^2 p (1 - p) / n.
  for (const int n : {1, 3, 10, 57, 800}) {
    for (int k = 0; k <= n; k += std::max(1, n / 7)) {
      const Interval interval = WilsonInterval(k, n);
      const double p_hat = static_cast<double>(k) / n;
      for (const double p : {interval.low, interval.high}) {
        EXPECT_NEAR((p_hat - p) * (p_hat - p), kZ * kZ * p * (1 - p) / n, 1e-12) << k << "/" << n;
      }
      EXPECT_LE(interval.low, p_hat);
      EXPECT_GE(interval.high, p_hat);
    }
  }
}

TEST(WilsonInterval, TouchesTheBoundaryExactlyAtTheExtremes) {
  EXPECT_EQ(WilsonInterval(0, 10).low, 0);
  EXPECT_EQ(WilsonInterval(10, 10).high, 1);
  EXPECT_GT(WilsonInterval(0, 10).high, 0.2);
}

TEST(WilsonInterval, IsNotANumberWithoutData) { EXPECT_TRUE(std::isnan(WilsonInterval(0, 0).low)); }

TEST(WilsonInterval, AgreesWithSciPy) {
  const std::string text = SciPy(
      "from scipy.stats import binomtest as b; c=b(7,20).proportion_ci(method='wilson'); "
      "print(repr(c.low), repr(c.high))");
  double low = 0, high = 0;
  if (std::sscanf(text.c_str(), "%lf %lf", &low, &high) != 2)
    GTEST_SKIP() << "no /usr/bin/python3 with SciPy (package python3-scipy)";
  EXPECT_NEAR(WilsonInterval(7, 20).low, low, 1e-12);
  EXPECT_NEAR(WilsonInterval(7, 20).high, high, 1e-12);
}

TEST(Quantile, InterpolatesBetweenOrderStatistics) {
  EXPECT_DOUBLE_EQ(Quantile({1, 2, 3, 4}, 0), 1);
  EXPECT_DOUBLE_EQ(Quantile({1, 2, 3, 4}, 1), 4);
  EXPECT_DOUBLE_EQ(Quantile({1, 2, 3, 4}, 0.5), 2.5);
  EXPECT_DOUBLE_EQ(Quantile({5}, 0.3), 5);
}

TEST(UpperMedian, IsOneOfTheValues) {
  EXPECT_EQ(UpperMedian({3, 1, 2}), 2);
  EXPECT_EQ(UpperMedian({4, 1, 3, 2}), 3);
  EXPECT_EQ(UpperMedian({7}), 7);
}

TEST(ClusterBootstrap, IntervalOfAMeanIsThatOfItsNormalLimit) {
  // 400 clusters of one value each: the interval is mean -+ 1.96 s / sqrt(n). Monte-Carlo error of
  // a 2.5 % quantile over 20000 replicates is about 2 % of the half width, and the normal limit
  // errs by less.
  std::vector<ClusteredValue> values;
  RandomStream stream(StreamKey("test"));
  double sum = 0, squares = 0;
  for (int i = 0; i < 400; ++i) {
    const double value = stream.Normal();
    values.push_back({i, 0, value});
    sum += value;
    squares += value * value;
  }
  const double mean = sum / 400, half = kZ * std::sqrt((squares / 400 - mean * mean) / 400);
  const BootstrapResult result = ClusterBootstrap(values, 20000, StreamKey("test/bootstrap"));
  EXPECT_NEAR(result.estimate, mean, 1e-12);
  EXPECT_NEAR(result.interval.low, mean - half, 0.08 * half);
  EXPECT_NEAR(result.interval.high, mean + half, 0.08 * half);
}

TEST(ClusterBootstrap, ResamplesWholeClusters) {
  // Twenty copies in each of 100 clusters carry no more information than one: the interval must not
  // shrink by sqrt(20), as one over single episodes would.
  std::vector<ClusteredValue> one, many;
  for (int i = 0; i < 100; ++i) {
    one.push_back({i, 0, i % 2 == 0 ? 1.0 : 0.0});
    for (int copy = 0; copy < 20; ++copy) many.push_back({i, 0, i % 2 == 0 ? 1.0 : 0.0});
  }
  const BootstrapResult a = ClusterBootstrap(one, 4000, StreamKey("k")),
                        b = ClusterBootstrap(many, 4000, StreamKey("k"));
  EXPECT_EQ(a.clusters, 100);
  EXPECT_DOUBLE_EQ(a.interval.low, b.interval.low);
  EXPECT_DOUBLE_EQ(a.interval.high, b.interval.high);
}

TEST(ClusterBootstrap, MatchesTheExactDistributionOfThreeClusters) {
  // Values 0, 0, 1: a replicate's mean is Binomial(3, 1/3) / 3; P(0) = 8/27 and P(3) = 1/27 > 2.5
  // %, so the percentile interval is [0, 1] exactly.
  const BootstrapResult result =
      ClusterBootstrap({{0, 0, 0}, {1, 0, 0}, {2, 0, 1}}, 20000, StreamKey("exact"));
  EXPECT_EQ(result.interval.low, 0);
  EXPECT_EQ(result.interval.high, 1);
}

TEST(ClusterBootstrap, WeighsStrataEquallyWhateverTheirSize) {
  std::vector<ClusteredValue> values;
  for (int i = 0; i < 10; ++i) values.push_back({i, 0, 1.0});
  for (int i = 0; i < 2; ++i) values.push_back({i, 1, 0.0});
  EXPECT_DOUBLE_EQ(ClusterBootstrap(values, 10, StreamKey("s")).estimate, 0.5);
}

TEST(ClusterBootstrap, DependsOnItsKeyOnly) {
  std::vector<ClusteredValue> values;
  for (int i = 0; i < 30; ++i) values.push_back({i, i % 3, i % 2 == 0 ? 1.0 : -0.5});
  const BootstrapResult first = ClusterBootstrap(values, 500, StreamKey("a"));
  std::reverse(values.begin(), values.end());
  const BootstrapResult second = ClusterBootstrap(values, 500, StreamKey("a"));
  EXPECT_EQ(first.interval.low, second.interval.low);
  EXPECT_EQ(first.interval.high, second.interval.high);
  EXPECT_NE(first.interval.low, ClusterBootstrap(values, 500, StreamKey("b")).interval.low);
}

TEST(ClusterBootstrap, OneClusterHasNoInterval) {
  const BootstrapResult result = ClusterBootstrap({{0, 0, 1}, {0, 0, 0}}, 100, StreamKey("one"));
  EXPECT_DOUBLE_EQ(result.estimate, 0.5);
  EXPECT_TRUE(std::isnan(result.interval.low));
}

}  // namespace
}  // namespace robostress
