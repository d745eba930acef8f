#include <gtest/gtest.h>

#include <array>
#include <memory>

#include "common/random.h"
#include "robostress.h"

namespace robostress {
namespace {

using StreamHandle = std::unique_ptr<robostress_stream, decltype(&robostress_stream_free)>;

StreamHandle MakeStream(const char* purpose) {
  robostress_stream* made = nullptr;
  EXPECT_EQ(robostress_stream_new(purpose, &made, nullptr, 0), ROBOSTRESS_OK);
  return {made, robostress_stream_free};
}

TEST(LibraryStream, DrawsTheBitsOfACounterBasedStream) {
  const StreamHandle handle = MakeStream("noise");
  robostress_stream_add_text(handle.get(), "tabletop_goal");
  robostress_stream_add_number(handle.get(), -3);
  RandomStream stream(StreamKey("noise").With("tabletop_goal").With(int64_t{-3}));
  std::array<double, 5> values;
  std::array<int, 5> integers;
  for (int round = 0; round < 3; ++round) {
    robostress_stream_uniform(handle.get(), values.data(), values.size());
    for (const double value : values) EXPECT_EQ(value, stream.Uniform());
    robostress_stream_normal(handle.get(), values.data(), values.size());
    for (const double value : values) EXPECT_EQ(value, stream.Normal());
    robostress_stream_integers(handle.get(), 7, integers.data(), integers.size());
    for (const int value : integers) EXPECT_EQ(value, stream.UniformInt(7));
  }
}

TEST(LibraryStream, BeginsAnewWithEachPartOfItsKey) {
  const StreamHandle used = MakeStream("noise"), fresh = MakeStream("noise");
  double first, again;
  robostress_stream_normal(used.get(), &first, 1);
  robostress_stream_add_number(used.get(), 1);
  robostress_stream_add_number(fresh.get(), 1);
  robostress_stream_normal(used.get(), &first, 1);
  robostress_stream_normal(fresh.get(), &again, 1);
  EXPECT_EQ(first, again);
}

TEST(LibraryStream, TakesNothingWithoutFault) {
  char error[100] = "";
  robostress_stream* made = nullptr;
  EXPECT_EQ(robostress_stream_new(nullptr, &made, error, sizeof(error)),
            ROBOSTRESS_INVALID_ARGUMENT);
  EXPECT_STREQ(error, "purpose is NULL");
  std::array<int, 2> zeros = {5, 5};
  robostress_stream_integers(MakeStream("x").get(), 0, zeros.data(), zeros.size());
  EXPECT_EQ(zeros, (std::array<int, 2>{0, 0}));
  robostress_stream_normal(nullptr, nullptr, 3);
  robostress_stream_add_text(nullptr, "x");
  robostress_stream_free(nullptr);
}

}  // namespace
}  // namespace robostress
