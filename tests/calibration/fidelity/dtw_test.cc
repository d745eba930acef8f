#include "calibration/fidelity/dtw.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "common/random.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

// The definition, read literally: the least sum over all paths by recursion without memory.
double LeastSum(const std::vector<double>& a, const std::vector<double>& b, int i, int j) {
  if (i < 0 || j < 0) return std::numeric_limits<double>::infinity();
  const double here = std::abs(a[i] - b[j]);
  if (i == 0 && j == 0) return here;
  return here + std::min({LeastSum(a, b, i - 1, j - 1), LeastSum(a, b, i - 1, j),
                          LeastSum(a, b, i, j - 1)});
}

TEST(DtwDistance, IsZeroBetweenASeriesAndItself) {
  const Dtw dtw = DtwDistance({1, 5, 2}, {1, 5, 2});
  EXPECT_EQ(dtw.total, 0);
  EXPECT_EQ(dtw.path_length, 3);
}

TEST(DtwDistance, WarpsTimeForFree) {
  const Dtw dtw = DtwDistance({0, 0, 1, 2, 2, 2}, {0, 1, 1, 1, 2});
  EXPECT_EQ(dtw.total, 0);
}

TEST(DtwDistance, EqualsWhatIsComputedByHand) {
  // Cells |a - b|:   b = 0 2 3
  //   a = 1:             1 1 2
  //   a = 2:             2 0 1
  //   a = 5:             5 3 2     best: (0,0) 1, (1,1) 0, (2,2) 2
  const Dtw dtw = DtwDistance({1, 2, 5}, {0, 2, 3});
  EXPECT_DOUBLE_EQ(dtw.total, 3);
  EXPECT_EQ(dtw.path_length, 3);
  EXPECT_DOUBLE_EQ(dtw.per_step, 1);
}

TEST(DtwDistance, OfASinglePointIsTheSumOfDistancesToIt) {
  const Dtw dtw = DtwDistance({2}, {1, 2, 4});
  EXPECT_DOUBLE_EQ(dtw.total, 3);
  EXPECT_EQ(dtw.path_length, 3);
}

TEST(DtwDistance, EqualsTheLeastSumOverAllPaths) {
  for (int trial = 0; trial < 40; ++trial) {
    RandomStream random(StreamKey("dtw_test").With(trial));
    std::vector<double> a(2 + random.UniformInt(6)), b(2 + random.UniformInt(6));
    for (double& x : a) x = random.Normal();
    for (double& x : b) x = random.Normal();
    const double sum =
        LeastSum(a, b, static_cast<int>(a.size()) - 1, static_cast<int>(b.size()) - 1);
    EXPECT_NEAR(DtwDistance(a, b).total, sum, 1e-12);
    EXPECT_NEAR(DtwDistance(b, a).total, sum, 1e-12);
  }
}

}  // namespace
}  // namespace robostress::calibration
