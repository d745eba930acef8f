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
  for (const StreamKey& key :
       {root, root.With(1), root.With(2), root.With(1).With(2), root.With(2).With(1),
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

TEST(StreamKey, KeepsEveryBitOfANumber) {
  std::set<std::pair<uint64_t, uint64_t>> keys;
  std::set<uint64_t> low, high;
  const StreamKey root("k");
  for (int64_t part = 0; part < 1024; ++part) {
    const StreamKey key = root.With(part);
    low.insert(key.lo());
    high.insert(key.hi());
  }
  for (int bit = 0; bit < 63; ++bit) {
    const StreamKey key = root.With(int64_t{1} << bit);
    low.insert(key.lo());
    high.insert(key.hi());
  }
  EXPECT_EQ(low.size(), 1024u + 53u);  // 2^0 to 2^9 are among the first
  EXPECT_EQ(high.size(), 1024u + 53u);
}

TEST(RandomStream, EveryBitOfAUniformNumberIsSetHalfTheTime) {
  RandomStream stream{StreamKey("bits")};
  constexpr int kDraws = 10000;
  std::vector<int> set(53);
  for (int i = 0; i < kDraws; ++i) {
    const auto bits = static_cast<uint64_t>(stream.Uniform() * 0x1.0p53);
    for (int bit = 0; bit < 53; ++bit) set[bit] += bits >> bit & 1;
  }
  for (int bit = 0; bit < 53; ++bit)  // five standard errors
    EXPECT_NEAR(set[bit], kDraws / 2.0, 5 * 0.5 * std::sqrt(kDraws)) << bit;
}

TEST(RandomStream, LargeRangesAreFlatToo) {
  // 3 * 2^29 does not divide 2^32: without rejection its lower two thirds come three times in four.
  constexpr int kRange = 3 << 29, kDraws = 20000;
  RandomStream stream{StreamKey("range")};
  int lower = 0;
  for (int i = 0; i < kDraws; ++i) lower += stream.UniformInt(kRange) < (1 << 30);
  EXPECT_NEAR(lower, kDraws * 2.0 / 3, 5 * std::sqrt(kDraws * 2.0 / 9));
}

}  // namespace
}  // namespace robostress
