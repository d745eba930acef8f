#include "common/random.h"

#include <cmath>
#include <set>
#include <vector>

#include "gtest/gtest.h"

namespace robostress {
namespace {

TEST(RandomStream, DependsOnTheKeyAndNotOnOtherStreams) {
  RandomStream a{StreamKey("noise").With(3)};
  RandomStream other{StreamKey("noise").With(4)};
  std::vector<double> first;
  for (int i = 0; i < 10; ++i) {
    first.push_back(a.Normal());
    other.Normal();
  }
  RandomStream again{StreamKey("noise").With(3)};
  for (const double value : first) EXPECT_EQ(again.Normal(), value);
}

TEST(StreamKey, DistinguishesOrderTypeAndBoundaries) {
  const StreamKey root("k");
  std::set<std::pair<uint64_t, uint64_t>> keys;
  for (const StreamKey& key : {root, root.With(1), root.With(2), root.With(1).With(2), root.With(2).With(1),
                               root.With("1"), root.With("12"), root.With("1").With("2"), root.With(""), root.With(-1)}) {
    keys.emplace(key.lo(), key.hi());
  }
  EXPECT_EQ(keys.size(), 10u);
}

TEST(RandomStream, UniformAndNormalHaveTheirMoments) {
  RandomStream stream{StreamKey("moments")};
  constexpr int kDraws = 200000;
  double uniform = 0, normal = 0, square = 0, fourth = 0;
  for (int i = 0; i < kDraws; ++i) {
    uniform += stream.Uniform();
    const double x = stream.Normal();
    normal += x;
    square += x * x;
    fourth += x * x * x * x;
  }
  // Four standard errors each.
  EXPECT_NEAR(uniform / kDraws, 0.5, 4 * 0.2887 / std::sqrt(kDraws));
  EXPECT_NEAR(normal / kDraws, 0.0, 4 / std::sqrt(kDraws));
  EXPECT_NEAR(square / kDraws, 1.0, 4 * std::sqrt(2.0 / kDraws));
  EXPECT_NEAR(fourth / kDraws, 3.0, 4 * std::sqrt(96.0 / kDraws));
}

TEST(RandomStream, UniformIntIsFlat) {
  RandomStream stream{StreamKey("int")};
  std::vector<int> counts(7);
  for (int i = 0; i < 70000; ++i) ++counts[stream.UniformInt(7)];
  double chi2 = 0;
  for (const int count : counts) chi2 += (count - 10000.0) * (count - 10000.0) / 10000.0;
  EXPECT_LT(chi2, 22.5);  // 6 degrees of freedom, p = 0.001
}

TEST(Philox, GivesTheKnownAnswers) {
  // Random123's known-answer vectors.
  EXPECT_EQ(Philox4x32({0, 0, 0, 0}, {0, 0}),
            (std::array<uint32_t, 4>{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(Philox4x32({~0u, ~0u, ~0u, ~0u}, {~0u, ~0u}),
            (std::array<uint32_t, 4>{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
}

}  // namespace
}  // namespace robostress
