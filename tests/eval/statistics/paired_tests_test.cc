#include "eval/statistics/paired_tests.h"

#include <cmath>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

const StreamKey kKey("paired tests");

// Numbers that a Python script with SciPy prints; empty where there is none.
std::vector<double> SciPy(const std::string& script) {
  const auto [output, code] = RunProgram("/usr/bin/python3", "-c \"" + script + "\"");
  std::vector<double> numbers;
  std::istringstream text(output);
  for (double number; code == 0 && text >> number;) numbers.push_back(number);
  return numbers;
}

#define SKIP_WITHOUT_SCIPY(numbers, count)                                              \
  if ((numbers).size() != static_cast<size_t>(count))                                   \
  GTEST_SKIP() << "no /usr/bin/python3 with SciPy (package python3-scipy); it printed " \
               << (numbers).size() << " numbers"

// Two strata, up to two pairs of a stratum in a cluster; outcomes -1, 0, 1.
std::vector<ClusteredValue> Differences(int clusters) {
  std::vector<ClusteredValue> values;
  RandomStream stream(StreamKey("differences"));
  for (int cluster = 0; cluster < clusters; ++cluster) {
    for (int stratum = 0; stratum < 2; ++stratum) {
      const int copies = stratum == 0 ? 1 + cluster % 2 : 1;
      for (int copy = 0; copy < copies; ++copy)
        values.push_back({cluster, stratum, static_cast<double>(stream.UniformInt(3) - 1)});
    }
  }
  return values;
}

std::string PythonList(const std::vector<ClusteredValue>& values) {
  std::string text = "[";
  for (const ClusteredValue& v : values)
    absl::StrAppend(&text, "(", v.cluster, ",", v.stratum, ",", v.value, "),");
  return text + "]";
}

TEST(ExactMcNemar, AgreesWithSciPy) {
  const std::vector<double> expected = SciPy(
      "from scipy.stats import binomtest\n"
      "for a,b in ((0,0),(1,0),(3,1),(7,7),(12,30),(120,90)): "
      "print(repr(binomtest(a,a+b).pvalue) if a+b else 1.0)");
  SKIP_WITHOUT_SCIPY(expected, 6);
  const int pairs[][2] = {{0, 0}, {1, 0}, {3, 1}, {7, 7}, {12, 30}, {120, 90}};
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_NEAR(ExactMcNemar(pairs[i][0], pairs[i][1]), expected[i], 1e-12 * expected[i]) << i;
    EXPECT_EQ(ExactMcNemar(pairs[i][0], pairs[i][1]), ExactMcNemar(pairs[i][1], pairs[i][0]));
  }
}

TEST(ClusterSignFlipTest, IsMcNemarWhereEachClusterHoldsOnePair) {
  std::vector<ClusteredValue> values;
  for (int i = 0; i < 30; ++i) values.push_back({i, 0, i < 9 ? 1.0 : i < 13 ? -1.0 : 0.0});
  const SignFlipResult result = ClusterSignFlipTest(values, kKey);
  EXPECT_TRUE(result.exact);
  EXPECT_NEAR(result.p_value, ExactMcNemar(9, 4), 1e-12);
}

TEST(ClusterSignFlipTest, CountsArrangementsOfThreeClusters) {
  // Contributions 2, 1, 1: of the 8 sums +-2 +-1 +-1 two have size 4.
  const std::vector<ClusteredValue> values = {{0, 0, 1}, {0, 0, 1}, {1, 0, 1}, {2, 0, 1}};
  EXPECT_NEAR(ClusterSignFlipTest(values, kKey).p_value, 2.0 / 8, 1e-12);
}

TEST(ClusterSignFlipTest, CopiesOfAPairAreNoEvidence) {
  std::vector<ClusteredValue> values;
  for (int copy = 0; copy < 50; ++copy) values.push_back({0, 0, 1.0});
  EXPECT_EQ(ClusterSignFlipTest(values, kKey).p_value, 1);
  EXPECT_LT(ExactMcNemar(50, 0), 1e-9);
}

TEST(ClusterSignFlipTest, EnumerationAgreesWithSciPysPermutationTest) {
  // 12 clusters: SciPy goes through all 4096 arrangements. It gets what each cluster adds to the
  // mean over strata in whole numbers, so that no tie is lost to rounding: 18 pairs in stratum 0,
  // 12 in stratum 1, hence weights 2 and 3.
  const std::vector<ClusteredValue> values = Differences(12);
  const std::vector<double> expected =
      SciPy(absl::StrCat("V=", PythonList(values),
                         "\nimport numpy as np\nfrom scipy.stats import permutation_test\n"
                         "assert [sum(1 for v in V if v[1]==s) for s in (0,1)]==[18,12]\n"
                         "c=np.zeros(12)\n"
                         "for k,s,d in V: c[k]+=d*(2,3)[s]\n"
                         "r=permutation_test((c,), lambda x, axis: x.sum(axis), n_resamples=5000, "
                         "permutation_type='samples', vectorized=True)\n"
                         "print(repr(r.pvalue))"));
  SKIP_WITHOUT_SCIPY(expected, 1);
  const SignFlipResult result = ClusterSignFlipTest(values, kKey);
  EXPECT_TRUE(result.exact);
  EXPECT_NEAR(result.p_value, expected[0], 1e-12);
  EXPECT_LT(result.p_value, 1);
}

TEST(ClusterSignFlipTest, DrawsWhereItCannotEnumerateAndComesNear) {
  std::vector<ClusteredValue> values = Differences(40);
  const double exact = ClusterSignFlipTest(values, kKey).p_value;
  for (ClusteredValue& value : values) value.value *= 0.3;  // no whole numbers
  const SignFlipResult drawn = ClusterSignFlipTest(values, kKey);
  EXPECT_FALSE(drawn.exact);
  EXPECT_NEAR(drawn.p_value, exact, 4 * std::sqrt(0.25 / kSignFlipDraws));
  EXPECT_EQ(drawn.p_value, ClusterSignFlipTest(values, kKey).p_value) << "the key seeds the draws";
}

TEST(ClusterSignFlipTest, NoDifferenceGivesOne) {
  EXPECT_EQ(ClusterSignFlipTest({{0, 0, 0}, {1, 0, 0}}, kKey).p_value, 1);
  EXPECT_EQ(ClusterSignFlipTest({}, kKey).p_value, 1);
}

TEST(ClusterBootstrap, PercentileIntervalAgreesWithSciPy) {
  // Two Monte-Carlo estimates of the same quantiles: 1 % of the width of a 95 % interval is about
  // four standard errors at 20,000 and 100,000 replicates; both are seeded.
  const std::vector<ClusteredValue> values = Differences(40);
  const std::vector<double> expected = SciPy(absl::StrCat(
      "V=", PythonList(values), "\nimport numpy as np\nfrom scipy.stats import bootstrap\n",
      "sums=np.zeros((2,40)); counts=np.zeros((2,40))\n"
      "for k,s,d in V: sums[s,k]+=d; counts[s,k]+=1\n"
      "def mean(i, axis=-1):\n"
      "  i=i.astype(int)\n"
      "  return sum(sums[s][i].sum(axis)/counts[s][i].sum(axis) for s in (0,1))/2\n"
      "r=bootstrap((np.arange(40.0),), mean, n_resamples=100000, method='percentile', "
      "vectorized=True, batch=10000, random_state=3).confidence_interval\n"
      "print(r.low, r.high)"));
  SKIP_WITHOUT_SCIPY(expected, 2);
  const BootstrapResult ours = ClusterBootstrap(values, 20000, kKey);
  const double tolerance = 0.015 * (expected[1] - expected[0]);
  EXPECT_NEAR(ours.interval.low, expected[0], tolerance);
  EXPECT_NEAR(ours.interval.high, expected[1], tolerance);
}

TEST(ClusterSignFlipTest, ADrawnPValueIsNeverZero) {
  // 64 clusters that all say the same: 2^-63, far below what draws can see.
  std::vector<ClusteredValue> values;
  for (int i = 0; i < 64; ++i) values.push_back({i, 0, 0.3});
  const SignFlipResult result = ClusterSignFlipTest(values, kKey);
  EXPECT_FALSE(result.exact);
  EXPECT_EQ(result.p_value, 1.0 / (1.0 + kSignFlipDraws));
}

TEST(HolmAdjust, StepsDownAndIsMonotone) {
  EXPECT_THAT(HolmAdjust({0.01, 0.04, 0.03, 0.005}),
              ::testing::Pointwise(::testing::DoubleNear(1e-12), {0.03, 0.06, 0.06, 0.02}));
  EXPECT_THAT(HolmAdjust({0.6, 0.9}), ::testing::ElementsAre(1, 1));
}

TEST(HolmAdjust, DoesNotCountWhatWasNotCompared) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<double> adjusted = HolmAdjust({nan, 0.02});
  EXPECT_TRUE(std::isnan(adjusted[0]));
  EXPECT_DOUBLE_EQ(adjusted[1], 0.02);
}

TEST(DesignEffect, IsTheClusterSizeForCopiesAndOneForSinglePairs) {
  std::vector<ClusteredValue> single, copies;
  for (int i = 0; i < 20; ++i) {
    single.push_back({i, 0, i % 2 == 0 ? 1.0 : -1.0});
    for (int copy = 0; copy < 3; ++copy) copies.push_back({i, 0, i % 2 == 0 ? 1.0 : -1.0});
  }
  EXPECT_NEAR(DesignEffect(single), 1, 1e-12);
  EXPECT_NEAR(DesignEffect(copies), 3, 1e-12);
  EXPECT_EQ(DesignEffect({{0, 0, 1}, {1, 0, 1}}), 1);
}

TEST(DesignEffect, CountsDeviationsFromTheMeanAndNotTheMeanItself) {
  // Three copies of each of 20 values whose mean is 0.25.
  std::vector<ClusteredValue> copies;
  for (int i = 0; i < 20; ++i)
    for (int copy = 0; copy < 3; ++copy) copies.push_back({i, 0, i % 4 == 0 ? 1.0 : 0.0});
  EXPECT_NEAR(DesignEffect(copies), 3, 1e-12);
}

TEST(PairsNeeded, IsConnorsFormulaWithSciPysNormalQuantiles) {
  const std::vector<double> expected = SciPy(
      "from scipy.stats import norm\nfrom math import sqrt\n"
      "for d,psi,a,b in ((0.05,0.3,0.05,0.8),(0.2,0.2,0.01,0.95),(0.1,0.9,1e-20,0.3)): "
      "print(repr((norm.isf(a/2)*sqrt(psi)+norm.ppf(b)*sqrt(psi-d*d))**2/(d*d)))");
  SKIP_WITHOUT_SCIPY(expected, 3);
  EXPECT_NEAR(*PairsNeeded(0.05, 0.3), expected[0], 1e-9 * expected[0]);
  EXPECT_NEAR(*PairsNeeded(0.2, 0.2, 0.01, 0.95), expected[1], 1e-9 * expected[1]);
  EXPECT_NEAR(*PairsNeeded(0.1, 0.9, 1e-20, 0.3), expected[2], 1e-9 * expected[2]);
}

TEST(PairsNeeded, GivesThePowerThatTheExactTestHas) {
  // With the stated number of pairs SciPy's binomial distributions give McNemar's exact test 78 to
  // 82 % power at d = 5 points, psi = 0.3: the formula is the normal limit, the exact test a little
  // conservative.
  const std::optional<double> pairs = PairsNeeded(0.05, 0.3);
  ASSERT_TRUE(pairs.has_value());
  EXPECT_NEAR(*pairs, 940, 2) << "the plan's figure";
  const std::vector<double> power = SciPy(
      absl::StrCat("from scipy.stats import binom\nimport numpy as np\nN=", std::ceil(*pairs), "\n",
                   "total=0\nfor m in range(N+1):\n"
                   "  w=binom.pmf(m,N,0.3)\n"
                   "  if w<1e-9: continue\n"
                   "  k=np.arange(m+1); p=np.minimum(1,2*binom.cdf(np.minimum(k,m-k),m,0.5))\n"
                   "  total+=w*binom.pmf(k,m,0.175/0.3)[p<=0.05].sum()\n"
                   "print(total)"));
  SKIP_WITHOUT_SCIPY(power, 1);
  EXPECT_NEAR(power[0], 0.8, 0.02);
}

TEST(PairsNeeded, RefusesNumbersThatContradictEachOther) {
  EXPECT_FALSE(PairsNeeded(0.0, 0.3).has_value());
  EXPECT_FALSE(PairsNeeded(0.4, 0.3).has_value());
  EXPECT_FALSE(PairsNeeded(0.1, 1.2).has_value());
  EXPECT_DOUBLE_EQ(*PairsNeeded(-0.05, 0.3), *PairsNeeded(0.05, 0.3));
}

}  // namespace
}  // namespace robostress
