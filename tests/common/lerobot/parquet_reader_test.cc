#include "common/lerobot/parquet_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/lerobot/parquet_table.h"
#include "common/random.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string Table() {
  auto table = ParquetTable({{"action", "", std::vector<float>{1, 2, 3, 4, 5, 6}, false, 2},
                             {"index", "", std::vector<int64_t>{7, 8, -9}},
                             {"picture", "bytes", std::vector<std::string>{"a", "b", "c"}},
                             {"picture", "path", std::vector<std::string>{"x", "y", "z"}, true},
                             {"done", "", std::vector<uint8_t>{0, 0, 1}}});
  EXPECT_TRUE(table.ok());
  return *table;
}

TEST(ParquetReaderTest, ReadsTheNumbersThatAreWritten) {
  const auto reader = ParquetReader::Parse("t.parquet", Table());
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_EQ(reader->rows(), 3);
  EXPECT_THAT(*reader->Numbers("action", 2), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_THAT(*reader->Numbers("index"), ElementsAre(7, 8, -9));
}

TEST(ParquetReaderTest, SaysWhatIsOtherwise) {
  const auto reader = ParquetReader::Parse("t.parquet", Table());
  ASSERT_TRUE(reader.ok());
  const auto why = [&](const std::string& column, int list) {
    const auto numbers = reader->Numbers(column, list);
    EXPECT_FALSE(numbers.ok()) << column;
    return std::string(numbers.status().message());
  };
  EXPECT_THAT(why("nothing", 0), HasSubstr("t.parquet: has no column nothing"));
  EXPECT_THAT(why("action", 3), HasSubstr("a list has not 3 numbers"));
  EXPECT_THAT(why("action", 0), HasSubstr("has no column action"));
  EXPECT_THAT(why("done", 0), HasSubstr("values are of type 0"));
  EXPECT_THAT(why("picture", 0), HasSubstr("has no column picture"));
  EXPECT_THAT(std::string(ParquetReader::Parse("t", "PAR1PAR1").status().message()),
              HasSubstr("no whole Parquet file"));
}

// Whatever is changed in a file it is read or refused, and never read beyond its end (under
// sanitizers) nor into more numbers than it holds.
TEST(ParquetReaderTest, BearsEveryChangedByteAndEveryCut) {
  const std::string whole = Table();
  RandomStream random(StreamKey("parquet"));
  int read = 0, refused = 0;
  const auto take = [&](std::string bytes) {
    const auto reader = ParquetReader::Parse("t", std::move(bytes));
    const auto action = reader.ok() ? reader->Numbers("action", 2) : reader.status();
    const auto index = reader.ok() ? reader->Numbers("index") : reader.status();
    EXPECT_LE(action.ok() ? action->size() : 0, whole.size());
    EXPECT_LE(index.ok() ? index->size() : 0, whole.size());
    ++(action.ok() && index.ok() ? read : refused);
  };
  for (size_t size = 0; size < whole.size(); ++size) take(whole.substr(0, size));
  EXPECT_EQ(read, 0) << "a file that was cut off";
  for (size_t at = 0; at < whole.size(); ++at) {
    for (const int value : {0, 1, 127, 128, 255, random.UniformInt(256)}) {
      std::string bytes = whole;
      bytes[at] = static_cast<char>(value);
      take(bytes);
    }
  }
  for (int i = 0; i < 20000; ++i) {
    std::string bytes = whole;
    for (int k = 0; k < 4; ++k)
      bytes[static_cast<size_t>(random.UniformInt(static_cast<int>(bytes.size())))] =
          static_cast<char>(random.UniformInt(256));
    take(bytes);
  }
  EXPECT_GT(read, 100) << "values may change";
  EXPECT_GT(refused, 100);
}

}  // namespace
}  // namespace robostress
