#include "common/recordings/mcap_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <cstring>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/recordings/byte_source.h"
#include "common/recordings/cdr_decoder.h"
#include "common/recordings/cdr_encoder.h"
#include "tests/common/recordings/recording_bytes.h"

namespace robostress::recording_test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

class McapWriterTest : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = testing::TempDir() + "/mcap_writer";
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    path_ = folder_ + "/file.mcap";
  }
  std::string folder_, path_;
};

std::string Noise(size_t size, uint32_t seed) {
  std::string bytes(size, '\0');
  for (char& byte : bytes) byte = static_cast<char>((seed = seed * 1664525 + 1013904223) >> 24);
  return bytes;
}

// 40 messages of 100 kB on two channels, 7 ms apart from 5 s on: five chunks.
std::string PayloadOf(int i) { return Noise(100'000, static_cast<uint32_t>(i)); }
uint64_t TimeOf(int i) { return 5'000'000'000 + 7'000'000 * static_cast<uint64_t>(i); }

absl::Status WriteExample(const std::string& path) {
  auto file = McapWriter::Create(path, "ros2");
  if (!file.ok()) return file.status();
  const uint16_t schema = file->AddSchema({"std_msgs/msg/String", "ros2msg", "string data\n"});
  const uint16_t first = file->AddChannel({"/first", "cdr", schema});
  const uint16_t second = file->AddChannel({"/second", "cdr", schema});
  for (int i = 0; i < 40; ++i) {
    const absl::Status status = file->Write(i % 2 == 0 ? first : second, TimeOf(i), PayloadOf(i));
    if (!status.ok()) return status;
  }
  const absl::Status status = file->AddMetadata("about", {{"a", "1"}, {"b", "2"}});
  return status.ok() ? file->Publish() : status;
}

template <class T>
T NumberAt(absl::string_view bytes, size_t at) {
  T value{};
  EXPECT_LE(at + sizeof(T), bytes.size());
  if (at + sizeof(T) <= bytes.size()) std::memcpy(&value, bytes.data() + at, sizeof(T));
  return value;
}

// A record's content, of this kind; its opcode is at `at`.
absl::string_view ContentAt(absl::string_view file, uint64_t at, uint8_t opcode) {
  EXPECT_EQ(NumberAt<uint8_t>(file, at), opcode) << "at " << at;
  return file.substr(at + 9, NumberAt<uint64_t>(file, at + 1));
}

TEST_F(McapWriterTest, TheReaderReadsWhatWasWritten) {
  ASSERT_TRUE(WriteExample(path_).ok());
  auto reader = McapReader::Open(path_);
  ASSERT_TRUE(reader.ok()) << reader.status();
  McapMessage message;
  for (int i = 0; i < 40; ++i) {
    const auto found = (*reader)->Next(&message);
    ASSERT_TRUE(found.ok() && *found) << found.status();
    EXPECT_EQ((*reader)->channel(message.channel).topic, i % 2 == 0 ? "/first" : "/second");
    EXPECT_EQ(message.log_time_ns, TimeOf(i));
    EXPECT_EQ(message.data, PayloadOf(i));
  }
  EXPECT_FALSE(*(*reader)->Next(&message));
  EXPECT_THAT((*reader)->notes(), ElementsAre());
  EXPECT_EQ((*reader)->schema(1)->text, "string data\n");
}

// Footer -> summary -> chunk index -> message index -> message, as a viewer seeks.
TEST_F(McapWriterTest, IndexesLeadToEveryMessage) {
  ASSERT_TRUE(WriteExample(path_).ok());
  const std::string file = *ReadFile(path_);
  const auto footer = ContentAt(file, file.size() - 8 - 29, 2);
  const auto summary_at = NumberAt<uint64_t>(footer, 0);
  const auto crc =
      static_cast<uint32_t>(crc32_z(0, reinterpret_cast<const Bytef*>(file.data() + summary_at),
                                    file.size() - 8 - 4 - summary_at));
  EXPECT_EQ(NumberAt<uint32_t>(footer, 16), crc);
  std::map<uint64_t, std::string> found;  // data by time
  std::vector<int> records(16);
  for (uint64_t at = summary_at; NumberAt<uint8_t>(file, at) != 2;
       at += 9 + NumberAt<uint64_t>(file, at + 1)) {
    const auto opcode = NumberAt<uint8_t>(file, at);
    ++records[opcode];
    if (opcode != 8) continue;
    const auto index = ContentAt(file, at, 8);
    const auto chunk = ContentAt(file, NumberAt<uint64_t>(index, 16), 6);
    EXPECT_EQ(chunk.size() + 9, NumberAt<uint64_t>(index, 24));
    EXPECT_EQ(chunk.substr(0, 16), index.substr(0, 16)) << "start and end";
    const auto unpacked = InflateBlock("zstd", chunk.substr(44), uint64_t{2} << 20);
    ASSERT_TRUE(unpacked.ok()) << unpacked.status();
    EXPECT_LT(unpacked->size(), McapWriter::kChunkBytes + 101'000);
    ASSERT_EQ(NumberAt<uint32_t>(index, 32), 20) << "two channels";
    for (const size_t entry : {36, 46}) {
      const auto messages = ContentAt(file, NumberAt<uint64_t>(index, entry + 2), 7);
      EXPECT_EQ(NumberAt<uint16_t>(messages, 0), NumberAt<uint16_t>(index, entry));
      for (size_t row = 6; row < messages.size(); row += 16) {
        const auto message = ContentAt(*unpacked, NumberAt<uint64_t>(messages, row + 8), 5);
        EXPECT_EQ(NumberAt<uint16_t>(message, 0), NumberAt<uint16_t>(index, entry));
        const auto time_ns = NumberAt<uint64_t>(messages, row);
        EXPECT_EQ(NumberAt<uint64_t>(message, 6), time_ns);
        EXPECT_GE(time_ns, NumberAt<uint64_t>(index, 0));
        EXPECT_LE(time_ns, NumberAt<uint64_t>(index, 8));
        found[time_ns] = std::string(message.substr(22));
      }
    }
  }
  ASSERT_EQ(found.size(), 40);
  for (int i = 0; i < 40; ++i) EXPECT_EQ(found[TimeOf(i)], PayloadOf(i)) << i;
  EXPECT_THAT(records, ElementsAre(0, 0, 0, 1, 2, 0, 0, 0, 5, 0, 0, 1, 0, 1, 5, 0));
}

TEST_F(McapWriterTest, WhatWasNotPublishedLeavesNothing) {
  {
    auto file = McapWriter::Create(path_, "");
    ASSERT_TRUE(file.ok()) << file.status();
    const uint16_t channel = file->AddChannel({"/big", "cdr", 0});
    ASSERT_TRUE(file->Write(channel, 1, PayloadOf(1)).ok());
    EXPECT_FALSE(fs::exists(path_));
    const std::string big(McapReader::kMostChunk / 2 + 1, 'x');
    EXPECT_THAT(std::string(file->Write(channel, 2, big).message()),
                HasSubstr("a message of /big has 134217729 bytes, at most 134217728"));
  }
  EXPECT_TRUE(fs::is_empty(folder_));
  EXPECT_TRUE(absl::IsNotFound(McapWriter::Create(folder_ + "/none/file.mcap", "").status()));
}

TEST(CdrEncoderTest, AlignsFieldsAsTheSpecificationSays) {
  const JointStateFields fields{1'234'000'000'567, {"a", "elbow"}, {0.25, -1e-9}, {3}, {}};
  EXPECT_EQ(CdrEncoder()
                .Header(fields.stamp_ns, "base")
                .Texts(fields.name)
                .Numbers(fields.position)
                .Numbers(fields.velocity)
                .Numbers(fields.effort)
                .Message(),
            JointStateBytes(fields));
  const auto schema = RosSchema::Parse("a/msg/B", "string format\nuint8[] data\nfloat64 x\n");
  ASSERT_TRUE(schema.ok()) << schema.status();
  const auto value = DecodeCdr(
      *schema,
      CdrEncoder().Text("png").Bytes(absl::string_view("\1\0\3", 3)).Number(2.5).Message());
  ASSERT_TRUE(value.ok()) << value.status();
  EXPECT_THAT(value->items[0].texts, ElementsAre("png"));
  EXPECT_THAT(value->items[1].numbers, ElementsAre(1, 0, 3));
  EXPECT_THAT(value->items[2].numbers, ElementsAre(2.5));
}

}  // namespace
}  // namespace robostress::recording_test
