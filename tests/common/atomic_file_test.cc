#include "common/atomic_file.h"

#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

class AtomicFile : public ::testing::Test {
 protected:
  AtomicFile() : directory_(::testing::TempDir() + "atomic_file_test") {
    fs::remove_all(directory_);
    fs::create_directories(directory_);
  }
  ~AtomicFile() override { fs::remove_all(directory_); }
  size_t Files() const {
    return std::distance(fs::directory_iterator(directory_), fs::directory_iterator());
  }
  const std::string directory_;
};

TEST_F(AtomicFile, ReplacesTheWholeFileAndLeavesNothingElse) {
  const std::string path = directory_ + "/f";
  ASSERT_TRUE(WriteFileAtomically(path, "first version").ok());
  ASSERT_TRUE(WriteFileAtomically(path, std::string_view("a\0b", 3)).ok());
  EXPECT_EQ(*ReadFile(path), std::string("a\0b", 3));
  EXPECT_EQ(Files(), 1u);
}

TEST_F(AtomicFile, FailureKeepsTheOldFileAndNamesThePath) {
  const absl::Status status = WriteFileAtomically(directory_ + "/no/such/folder/f", "x");
  EXPECT_TRUE(absl::IsNotFound(status));
  EXPECT_THAT(std::string(status.message()), ::testing::HasSubstr("no/such/folder/f"));
  // A directory in the way: the rename fails after the temporary file was written.
  fs::create_directories(directory_ + "/d/inside");
  EXPECT_FALSE(WriteFileAtomically(directory_ + "/d", "x").ok());
  EXPECT_EQ(Files(), 1u);
}

TEST_F(AtomicFile, FullDiskIsReportedWithARemedy) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "no /dev/full here";
  const absl::Status status = AppendLine("/dev/full", "x");
  EXPECT_FALSE(status.ok());
  EXPECT_THAT(std::string(status.message()), ::testing::HasSubstr("/dev/full"));
}

TEST_F(AtomicFile, AppendedLinesFollowEachOther) {
  const std::string path = directory_ + "/log";
  ASSERT_TRUE(AppendLine(path, "one").ok());
  ASSERT_TRUE(AppendLine(path, "two").ok());
  EXPECT_EQ(*ReadFile(path), "one\ntwo\n");
}

TEST_F(AtomicFile, ALineForWhichThereIsNoRoomLeavesNoPartOfItself) {
  const std::string path = directory_ + "/log";
  ASSERT_TRUE(AppendLine(path, "one").ok());
  // A file may grow to 1000 bytes: the first write is short, the second fails.
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{1000, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const absl::Status status = AppendLine(path, std::string(5000, 'x'));
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  EXPECT_FALSE(status.ok());
  EXPECT_EQ(*ReadFile(path), "one\n");
}

TEST(Sha256, MatchesTheStandardsExample) {
  EXPECT_EQ(Sha256Hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(ReadFileUpTo, RefusesLargeFilesFoldersAndPipesBeforeItReads) {
  const std::string path = ::testing::TempDir() + "read_up_to." + std::to_string(::getpid());
  ASSERT_TRUE(WriteFileAtomically(path, "12345").ok());
  EXPECT_EQ(*ReadFileUpTo(path, 5), "12345");
  EXPECT_THAT(ReadFileUpTo(path, 4).status().message(),
              ::testing::HasSubstr("has 5 bytes, the limit is 4"));
  EXPECT_THAT(ReadFileUpTo("/dev/zero", 4).status().message(),
              ::testing::HasSubstr("not a regular file"));
  EXPECT_EQ(ReadFileUpTo(path + ".absent", 4).status().code(), absl::StatusCode::kNotFound);
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace robostress
