#include "common/recordings/mcap_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "common/random.h"
#include "common/recordings/recording.h"
#include "tests/common/recordings/collected_rows.h"
#include "tests/common/recordings/recording_bytes.h"

namespace robostress::recording_test {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::string FileOf(const std::string& bytes, const std::string& name = "test.mcap") {
  const std::string path = testing::TempDir() + "/" + name;
  std::ofstream(path, std::ios::binary) << bytes;
  return path;
}

std::string Declarations() {
  return McapSchemaRecord(1, "sensor_msgs/msg/JointState", JointStateText()) +
         McapChannelRecord(7, 1, "/joint_states");
}

std::string Messages(int first, int count) {
  std::string records;
  for (int i = first; i < first + count; ++i)
    records += McapMessageRecord(7, static_cast<uint64_t>(1000 + i),
                                 JointStateBytes({5'000'000'000 + i, {"a", "b"}, {0.1 * i, -0.3}}));
  return records;
}

absl::StatusOr<CollectedRows> Collect(const std::string& path) {
  CollectedRows rows;
  const absl::Status status = ReadRecording(path, {}, &rows);
  if (!status.ok()) return status;
  return rows;
}

std::string WhyRefused(const std::string& bytes) {
  const auto rows = Collect(FileOf(bytes));
  EXPECT_FALSE(rows.ok());
  return std::string(rows.status().message());
}

TEST(McapReaderTest, ReadsChunksOfEveryCompressionAndMessagesOutsideOfChunks) {
  const std::string path =
      FileOf(McapMagic() + McapHeader() + Declarations() + Messages(0, 2) +
             McapChunk("", Messages(2, 2)) + McapChunk("lz4", Declarations() + Messages(4, 2)) +
             McapChunk("zstd", Messages(6, 2)) + McapEnd());
  const auto rows = Collect(path);
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 8);
  for (int i = 0; i < 8; ++i) {
    EXPECT_EQ(rows->rows[i].log_ns, 1000 + i);
    EXPECT_EQ(rows->rows[i].stamp_ns, 5'000'000'000 + i);
    EXPECT_TRUE(rows->rows[i].stamped);
    EXPECT_EQ(rows->rows[i].values.at("position a"), 0.1 * i);
    EXPECT_EQ(rows->rows[i].values.at("position b"), -0.3);
  }
  EXPECT_THAT(rows->notes, IsEmpty());
}

TEST(McapReaderTest, ReadsAFileThatIsPackedAsAWhole) {
  const std::string path =
      FileOf(Packed("zstd", McapMagic() + Declarations() + Messages(0, 500) + McapEnd()),
             "test.mcap.zstd");
  const auto rows = Collect(path);
  ASSERT_TRUE(rows.ok()) << rows.status();
  EXPECT_EQ(rows->rows.size(), 500);
}

TEST(McapReaderTest, KeepsWholeChunksOfAFileWithoutAFooterAndSaysWhatIsLost) {
  const std::string whole = McapMagic() + Declarations() + McapChunk("lz4", Messages(0, 3));
  const std::string cut = McapChunk("lz4", Messages(3, 3));
  for (const size_t lost : {size_t{0}, size_t{1}, size_t{5}, cut.size() - 1}) {
    const auto rows = Collect(FileOf(whole + (lost == 0 ? "" : cut.substr(0, lost))));
    ASSERT_TRUE(rows.ok()) << rows.status();
    EXPECT_EQ(rows->rows.size(), 3);
    ASSERT_EQ(rows->notes.size(), 1);
    EXPECT_THAT(rows->notes[0], HasSubstr("ends without a footer"));
    EXPECT_THAT(rows->notes[0], HasSubstr("1 whole chunks are read"));
    if (lost > 0) {
      EXPECT_THAT(rows->notes[0], HasSubstr(absl::StrCat("the last ", lost, " bytes are not")));
    }
  }
}

TEST(McapReaderTest, PassesOverRecordsThatItDoesNotKnow) {
  const auto rows = Collect(FileOf(McapMagic() + McapRecord(0x7f, std::string(1000, 'x')) +
                                   Declarations() + McapRecord(0x09, "attachment") +
                                   McapChunk("", McapRecord(0x80, "y") + Messages(0, 1)) +
                                   McapEnd() + "whatever stands in a summary"));
  ASSERT_TRUE(rows.ok()) << rows.status();
  EXPECT_EQ(rows->rows.size(), 1);
}

TEST(McapReaderTest, CountsTopicsWithoutJoints) {
  const auto rows =
      Collect(FileOf(McapMagic() + McapChannelRecord(1, 0, "/camera", "jpeg") +
                     McapSchemaRecord(2, "sensor_msgs/msg/JointState", "", "ros2idl") +
                     McapChannelRecord(2, 2, "/idl") + McapMessageRecord(1, 5, "picture") +
                     McapMessageRecord(2, 6, "") + McapEnd()));
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 2);
  EXPECT_THAT(rows->rows[0].values, IsEmpty());
  EXPECT_FALSE(rows->channels[0].decoded);
  EXPECT_FALSE(rows->channels[1].decoded);
  ASSERT_EQ(rows->notes.size(), 1);
  EXPECT_THAT(rows->notes[0], HasSubstr("its schema is written as 'ros2idl'; read is ros2msg"));
}

TEST(McapReaderTest, NamesFileByteFieldAndValueOfWhatIsWrong) {
  const std::string head = McapMagic() + Declarations();
  EXPECT_THAT(WhyRefused("\x89MCAP1\r\n and more"), HasSubstr("test.mcap: is no MCAP file"));
  EXPECT_THAT(WhyRefused(head + McapRecord(5, "short")), HasSubstr("a message of 5 bytes"));
  EXPECT_THAT(WhyRefused(head + McapMessageRecord(9, 1, "")), HasSubstr("a message of channel 9"));
  EXPECT_THAT(WhyRefused(head + McapMessageRecord(7, uint64_t{1} << 63, "")),
              HasSubstr("log_time is 9223372036854775808"));
  EXPECT_THAT(WhyRefused(head + McapChannelRecord(8, 3, "/x")), HasSubstr("has schema 3"));
  EXPECT_THAT(WhyRefused(head + McapChannelRecord(7, 1, "/other")),
              HasSubstr("channel 7 is /other and was /joint_states before"));
  EXPECT_THAT(WhyRefused(head + McapSchemaRecord(1, "sensor_msgs/msg/JointState", "int8 x")),
              HasSubstr("schema 1 is sensor_msgs/msg/JointState"));
  EXPECT_THAT(WhyRefused(head + McapSchemaRecord(0, "a/A", "int8 x")), HasSubstr("schema 0"));
  EXPECT_THAT(WhyRefused(head + McapChunk("brotli", "")),
              HasSubstr("is compressed by 'brotli'; read are lz4 and zstd"));
  EXPECT_THAT(WhyRefused(head + McapChunk("", McapChunk("", ""))), HasSubstr("a chunk in a chunk"));
  EXPECT_THAT(WhyRefused(head + McapChunk("", "\x05")),
              HasSubstr("a record of 0 bytes in a chunk"));
  std::string damaged = McapChunk("", Messages(0, 1));
  damaged.back() ^= 1;
  EXPECT_THAT(WhyRefused(head + damaged), HasSubstr("its uncompressed_crc is"));
  EXPECT_THAT(WhyRefused(head + damaged), HasSubstr("mcap recover"));
}

// A size is believed only as far as there are bytes: none of these takes gigabytes.
TEST(McapReaderTest, BelievesNoSizeThatTheFileDoesNotHold) {
  const std::string head = McapMagic() + Declarations();
  EXPECT_THAT(WhyRefused(head + Raw(uint8_t{6}) + Raw(uint64_t{1} << 60)),
              HasSubstr("a record of 1152921504606846976 bytes"));
  const auto cut = Collect(FileOf(head + Raw(uint8_t{6}) + Raw(uint64_t{200} << 20) + "few"));
  ASSERT_TRUE(cut.ok()) << cut.status();
  EXPECT_THAT(cut->notes, ElementsAre(HasSubstr("the last 12 bytes are not")));
  const std::string records = Messages(0, 1);
  for (const char* compression : {"lz4", "zstd"}) {
    std::string chunk = McapChunk(compression, records);
    const std::string size = Raw(static_cast<uint64_t>(records.size()));
    const size_t at = chunk.find(size);
    EXPECT_THAT(WhyRefused(head + std::string(chunk).replace(at, 8, Raw(uint64_t{1} << 40))),
                HasSubstr("uncompressed_size is 1099511627776"));
    EXPECT_THAT(WhyRefused(head + std::string(chunk).replace(at, 8, Raw(uint64_t{200} << 20))),
                HasSubstr("its uncompressed_size is 209715200"));
    EXPECT_THAT(WhyRefused(head + std::string(chunk).replace(at, 8, Raw(uint64_t{10}))),
                HasSubstr("inflates to more than 10 bytes"));
  }
}

TEST(McapReaderTest, RefusesNamesThatChangeWithEveryMessage) {
  std::string records;
  for (int i = 0; i < 9000; ++i)
    records += McapMessageRecord(7, static_cast<uint64_t>(i),
                                 JointStateBytes({1 + i, {absl::StrCat("joint", i)}, {0.5}}));
  EXPECT_THAT(WhyRefused(McapMagic() + Declarations() + McapChunk("lz4", records) + McapEnd()),
              AllOf(HasSubstr("test.mcap: the position of joint"),
                    HasSubstr("names that change with every message are no joints")));
}

// Whatever is changed in a file it is read or refused with its name.
TEST(McapReaderTest, BearsEveryChangedByteAndEveryCut) {
  const std::string whole = McapMagic() + McapHeader() + Declarations() +
                            McapChunk("", Messages(0, 2)) + McapChunk("lz4", Messages(2, 2)) +
                            McapChunk("zstd", Messages(4, 2)) + McapEnd();
  RandomStream random(StreamKey("mcap"));
  int read = 0, refused = 0;
  const auto take = [&](const std::string& bytes) {
    const auto rows = Collect(FileOf(bytes));
    if (!rows.ok()) {
      EXPECT_THAT(std::string(rows.status().message()), HasSubstr("test.mcap"));
    }
    ++(rows.ok() ? read : refused);
  };
  for (size_t size = 0; size < whole.size(); size += 3) take(whole.substr(0, size));
  for (size_t at = 0; at < whole.size(); at += 2) {
    std::string bytes = whole;
    bytes[at] = static_cast<char>(random.UniformInt(256));
    take(bytes);
  }
  for (int i = 0; i < 1000; ++i) {
    std::string bytes = whole;
    for (int k = 0; k < 4; ++k)
      bytes[static_cast<size_t>(random.UniformInt(static_cast<int>(bytes.size())))] =
          static_cast<char>(random.UniformInt(256));
    take(bytes);
  }
  EXPECT_GT(read, 100);
  EXPECT_GT(refused, 100);
}

}  // namespace
}  // namespace robostress::recording_test
