#include "server/sessions/journal/record_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

class RecordFileTest : public ::testing::Test {
 protected:
  RecordFileTest()
      : path_(absl::StrCat(::testing::TempDir(), "/records-", getpid(), "-",
                           ::testing::UnitTest::GetInstance()->current_test_info()->name())) {
    std::filesystem::remove(path_);
  }
  ~RecordFileTest() override { std::filesystem::remove(path_); }

  absl::StatusOr<RecordExtent> Read(bool may_be_torn = true) {
    records_.clear();
    return ReadRecords(path_, may_be_torn, [this](std::string_view payload) {
      records_.emplace_back(payload);
      return absl::OkStatus();
    });
  }
  void Write(const std::vector<std::string>& payloads) {
    auto writer = RecordWriter::Create(path_);
    ASSERT_TRUE(writer.ok()) << writer.status();
    for (const std::string& payload : payloads) ASSERT_TRUE((*writer)->Append(payload).ok());
    ASSERT_TRUE((*writer)->Sync().ok());
  }

  const std::string path_;
  std::vector<std::string> records_;
};

TEST_F(RecordFileTest, GivesBackWhatWasAppended) {
  Write({"one", "", std::string(100000, 'x')});
  const auto extent = Read(false);
  ASSERT_TRUE(extent.ok()) << extent.status();
  EXPECT_EQ(extent->records, 3u);
  EXPECT_EQ(extent->bytes, std::filesystem::file_size(path_));
  EXPECT_THAT(records_, ElementsAre("one", "", std::string(100000, 'x')));
  EXPECT_EQ(RecordWriter::Create(path_).status().code(), absl::StatusCode::kAlreadyExists);
}

TEST_F(RecordFileTest, GoesOnBehindTheLastWholeRecordWhereverAWriteWasCutOff) {
  Write({"first", "second"});
  const std::string whole = *ReadFile(path_);
  for (size_t cut = 0; cut <= whole.size(); ++cut) {
    ASSERT_TRUE(WriteFileAtomically(path_, whole.substr(0, cut)).ok());
    const auto extent = Read();
    ASSERT_TRUE(extent.ok()) << cut << ": " << extent.status();
    const uint64_t records = cut < 25 ? 0 : cut < whole.size() ? 1 : 2;
    EXPECT_EQ(extent->records, records) << cut;
    EXPECT_EQ(extent->torn, cut != 0 && cut != 25 && cut != whole.size()) << cut;
    auto writer = RecordWriter::Continue(path_, extent->records, extent->bytes);
    ASSERT_TRUE(writer.ok()) << writer.status();
    ASSERT_TRUE((*writer)->Append("third").ok());
    ASSERT_TRUE(Read(false).ok());
    EXPECT_EQ(records_.back(), "third");
    EXPECT_EQ(records_.size(), records + 1);
  }
}

TEST_F(RecordFileTest, ADamagedRecordBeforeAWholeOneIsDataLossAndNamed) {
  Write({"first", "second", "third"});
  const std::string whole = *ReadFile(path_);
  for (size_t at = 0; at < 51; ++at) {  // every byte of the first two
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x40);
    ASSERT_TRUE(WriteFileAtomically(path_, damaged).ok());
    const absl::Status status = Read().status();
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss) << at;
    EXPECT_THAT(std::string(status.message()), HasSubstr(path_));
    EXPECT_THAT(std::string(status.message()), HasSubstr(at < 25 ? "byte 0 " : "byte 25 "));
  }
}

// The search for what follows damage goes over the file in windows of 256 KiB.
TEST_F(RecordFileTest, AWholeRecordIsFoundBehindDamageWhereverItBegins) {
  for (const size_t size : {262121, 262122, 262123, 262124, 262125, 262126, 900000}) {
    std::filesystem::remove(path_);
    Write({std::string(size, 'x'), "second"});
    std::string damaged = *ReadFile(path_);
    damaged[100] ^= 1;
    ASSERT_TRUE(WriteFileAtomically(path_, damaged).ok());
    EXPECT_EQ(Read().status().code(), absl::StatusCode::kDataLoss) << size;
  }
}

TEST_F(RecordFileTest, BytesThatOnlyLookLikeARecordDoNotMakeATornOneDamaged) {
  Write({"a", "b", "third"});
  const std::string like = ReadFile(path_)->substr(42);  // "third", whose sum will be another
  std::filesystem::remove(path_);
  std::string inside = like;
  inside.back() ^= 1;
  Write({"first", inside + std::string(50, 'x')});
  const std::string whole = *ReadFile(path_);
  ASSERT_TRUE(WriteFileAtomically(path_, whole.substr(0, whole.size() - 10)).ok());
  const auto extent = Read();
  ASSERT_TRUE(extent.ok()) << extent.status();
  EXPECT_TRUE(extent->torn);
  EXPECT_EQ(extent->records, 1u);
}

TEST_F(RecordFileTest, ARecordThatWasMovedIsDataLoss) {
  Write({"first", "other"});
  const std::string whole = *ReadFile(path_);
  ASSERT_TRUE(WriteFileAtomically(path_, whole.substr(25)).ok());
  EXPECT_EQ(Read().status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(RecordFileTest, AFullDiskLeavesTheFileAsItWas) {
  Write({"first"});
  auto writer = RecordWriter::Continue(path_, 1, 25);
  ASSERT_TRUE(writer.ok());
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit full{60, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &full);
  const absl::Status status = (*writer)->Append(std::string(1000, 'x'));  // a part of it has room
  setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr("nothing was taken"));
  EXPECT_EQ(std::filesystem::file_size(path_), 25u);
  ASSERT_TRUE((*writer)->Append("second").ok());
  ASSERT_TRUE(Read(false).ok());
  EXPECT_THAT(records_, ElementsAre("first", "second"));
}

}  // namespace
}  // namespace robostress
