#include "common/lerobot/parquet_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <snappy.h>
#include <zstd.h>

#include <cstring>

#include "common/random.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr int64_t kFloatType = 4;

ThriftValue Struct(std::vector<std::pair<int, ThriftValue>> fields) {
  ThriftValue value;
  value.kind = ThriftValue::kStruct;
  for (auto& [number, field] : fields) {
    value.numbers.push_back(number);
    value.list.push_back(std::move(field));
  }
  return value;
}
ThriftValue Number(int64_t integer) {
  ThriftValue value;
  value.integer = integer;
  return value;
}

std::string Floats(const std::vector<float>& values) {
  return {reinterpret_cast<const char*>(values.data()), 4 * values.size()};
}
std::string Zstd(const std::string& bytes) {
  std::string packed(ZSTD_compressBound(bytes.size()), '\0');
  packed.resize(ZSTD_compress(packed.data(), packed.size(), bytes.data(), bytes.size(), 3));
  return packed;
}
std::string Snappy(const std::string& bytes) {
  std::string packed;
  snappy::Compress(bytes.data(), bytes.size(), &packed);
  return packed;
}
std::string WithLength(const std::string& bytes) {
  const auto size = static_cast<uint32_t>(bytes.size());
  std::string result(4, '\0');
  std::memcpy(result.data(), &size, 4);
  return result + bytes;
}

ThriftValue DictionaryHeader(int64_t size, int64_t count) {
  return Struct(
      {{1, Number(2)}, {2, Number(size)}, {7, Struct({{1, Number(count)}, {2, Number(0)}})}});
}
ThriftValue DataHeader(int64_t size, int64_t count, int64_t encoding) {
  return Struct(
      {{1, Number(0)},
       {2, Number(size)},
       {5, Struct({{1, Number(count)}, {2, Number(encoding)}, {3, Number(3)}, {4, Number(3)}})}});
}

// Five values of a dictionary of three: a run of three times number 2, then 0 and 1 in a group of
// eight times two bits.
const std::string& Indices() {
  static const auto& indices = *new std::string({2, 3 << 1, 2, 1 << 1 | 1, 0 | 1 << 2, 0});
  return indices;
}

TEST(ParquetPageTest, ReadsDictionariesOfEveryCompression) {
  for (const int64_t codec : {0, 1, 6}) {
    const auto pack = [&](const std::string& bytes) {
      return codec == 1 ? Snappy(bytes) : codec == 6 ? Zstd(bytes) : bytes;
    };
    ParquetPages pages({kFloatType, codec, 0, 0, 0}, 5);
    ASSERT_TRUE(pages.Take(DictionaryHeader(12, 3), pack(Floats({1.5F, -2, 0.1F}))).ok());
    const absl::Status read = pages.Take(DataHeader(6, 5, 8), pack(Indices()));
    ASSERT_TRUE(read.ok()) << read;
    EXPECT_THAT(pages.numbers(), ElementsAre(0.1F, 0.1F, 0.1F, 1.5, -2));
  }
}

// A list that goes on in the next page, in both versions of pages.
TEST(ParquetPageTest, ReadsListsAcrossPages) {
  const ParquetColumnType type{kFloatType, 0, 1, 3, 3};
  const std::string all_three({5 << 1, 3});  // a run of five times level 3
  ParquetPages pages(type, 6);
  const std::string first =
      WithLength({1 << 1 | 1, 0b10110}) + WithLength(all_three) + Floats({1, 2, 3, 4, 5});
  absl::Status read = pages.Take(DataHeader(static_cast<int64_t>(first.size()), 5, 0), first);
  ASSERT_TRUE(read.ok()) << read;
  const std::string levels({1 << 1, 1, 1 << 1, 3});
  const ThriftValue header = Struct(
      {{1, Number(3)},
       {2, Number(8)},
       {8,
        Struct({{1, Number(1)}, {4, Number(0)}, {5, Number(2)}, {6, Number(2)}, {7, Number(0)}})}});
  read = pages.Take(header, levels + Floats({6}));
  ASSERT_TRUE(read.ok()) << read;
  EXPECT_THAT(pages.numbers(), ElementsAre(1, 2, 3, 4, 5, 6));
}

std::string WhyNot(ParquetPages pages, const ThriftValue& header, const std::string& body) {
  const absl::Status read = pages.Take(header, body);
  EXPECT_FALSE(read.ok());
  return std::string(read.message());
}

TEST(ParquetPageTest, NamesWhatIsWrong) {
  const ParquetColumnType plain{kFloatType, 0, 0, 0, 0}, list{kFloatType, 0, 1, 3, 3};
  const ParquetPages pages(plain, 5);
  EXPECT_THAT(WhyNot(pages, DataHeader(6, 5, 8), Indices()), HasSubstr("is not there"));
  EXPECT_THAT(WhyNot(pages, DataHeader(6, 5, 5), Indices()),
              HasSubstr("otherwise than plain or by a dictionary (5)"));
  EXPECT_THAT(WhyNot(pages, DataHeader(6, 6, 0), Indices()), HasSubstr("a page of 6 values"));
  EXPECT_THAT(WhyNot(pages, DataHeader(6, 5, 0), Indices()), HasSubstr("6 bytes for 5 values"));
  EXPECT_THAT(WhyNot(pages, DictionaryHeader(12, 1'000'000), Floats({1, 2, 3})),
              HasSubstr("a dictionary of 1000000 values"));
  EXPECT_THAT(WhyNot(ParquetPages({kFloatType, 2, 0, 0, 0}, 5), DataHeader(6, 5, 0), ""),
              HasSubstr("is compressed (gzip); read are none, snappy and zstd"));
  EXPECT_THAT(
      WhyNot(ParquetPages({kFloatType, 6, 0, 0, 0}, 5), DataHeader(7, 5, 0), Zstd("six...")),
      HasSubstr("is no zstd of 7 bytes"));
  EXPECT_THAT(
      WhyNot(ParquetPages({kFloatType, 1, 0, 0, 0}, 5), DataHeader(7, 5, 0), Snappy("six...")),
      HasSubstr("is no snappy of 7 bytes"));
  EXPECT_THAT(WhyNot(pages, DataHeader(int64_t{1} << 40, 5, 0), ""), HasSubstr("at most"));
  ParquetPages small(plain, 5);
  ASSERT_TRUE(small.Take(DictionaryHeader(4, 1), Floats({1})).ok());
  EXPECT_THAT(WhyNot(small, DataHeader(6, 5, 8), Indices()),
              HasSubstr("a value is number 2 of a dictionary of 1"));
  const std::string missing =
      WithLength({1 << 1 | 1, 0b110}) + WithLength({3 << 1, 2}) + Floats({1, 2});
  EXPECT_THAT(WhyNot(ParquetPages(list, 3), DataHeader(static_cast<int64_t>(missing.size()), 3, 0),
                     missing),
              HasSubstr("values are missing"));
}

// Whatever is changed in levels and indices, no more numbers come than are allowed.
TEST(ParquetPageTest, BearsChangedPages) {
  RandomStream random(StreamKey("pages"));
  const std::string body = WithLength({1 << 1 | 1, 0b10110}) + WithLength({5 << 1, 3}) + Indices();
  int read = 0;
  for (int i = 0; i < 20000; ++i) {
    std::string changed = body;
    for (int k = random.UniformInt(4); k > 0; --k)
      changed[static_cast<size_t>(random.UniformInt(static_cast<int>(body.size())))] =
          static_cast<char>(random.UniformInt(256));
    ParquetPages pages({kFloatType, 0, 1, 3, 3}, 6);
    ASSERT_TRUE(pages.Take(DictionaryHeader(12, 3), Floats({1, 2, 3})).ok());
    read += pages.Take(DataHeader(static_cast<int64_t>(body.size()), 5, 8), changed).ok();
    EXPECT_LE(pages.numbers().size(), 6);
  }
  EXPECT_GT(read, 1000);
}

}  // namespace
}  // namespace robostress
