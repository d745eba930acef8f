#include "common/safetensors_stream.h"

#include <unistd.h>

#include <filesystem>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

class SafetensorsStreamTest : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }
  size_t NumFiles() const {
    return std::distance(fs::directory_iterator(folder_), fs::directory_iterator());
  }
  const fs::path folder_ =
      fs::path(::testing::TempDir()) / ("stream." + std::to_string(::getpid()));
  const std::string path_ = (folder_ / "x.safetensors").string();
  const std::vector<SafetensorsStream::Entry> entries_ = {{"b", DType::kF32, {2}},
                                                          {"a", DType::kU8, {3}}};
};

TEST_F(SafetensorsStreamTest, PiecesMakeAFile) {
  auto stream = SafetensorsStream::Create(path_, {{"format", "pt"}}, entries_);
  ASSERT_TRUE(stream.ok()) << stream.status();
  const std::vector<uint8_t> bytes = {0, 0, 0x80, 0x3F, 0, 0, 0, 0xC0, 7, 8, 9};
  ASSERT_TRUE(stream->Append({bytes.data(), 5}).ok());
  ASSERT_TRUE(stream->Append({bytes.data() + 5, 6}).ok());
  EXPECT_FALSE(fs::exists(path_));
  ASSERT_TRUE(stream->Finish().ok());
  EXPECT_EQ(NumFiles(), 1u);
  const auto file = SafetensorsFile::Open(path_);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->metadata().at("format"), "pt");
  EXPECT_EQ(*file->ReadFloats("b"), (std::vector<float>{1, -2}));
  EXPECT_EQ(*file->ReadDoubles("a"), (std::vector<double>{7, 8, 9}));
  file->ReleasePages(file->Get("b")->bytes);
  EXPECT_EQ(*file->ReadFloats("b"), (std::vector<float>{1, -2}));
}

TEST_F(SafetensorsStreamTest, TooManyAndTooFewBytesPublishNothing) {
  {
    auto stream = SafetensorsStream::Create(path_, {}, entries_);
    ASSERT_TRUE(stream.ok());
    const std::vector<uint8_t> bytes(12);
    EXPECT_THAT(stream->Append(bytes).message(), HasSubstr("has room for 11"));
    EXPECT_TRUE(stream->Append({bytes.data(), 4}).ok());
    EXPECT_THAT(stream->Finish().message(), HasSubstr("7 bytes of its header's are missing"));
  }
  EXPECT_EQ(NumFiles(), 0u);
  const auto twice = SafetensorsStream::Create(path_, {}, {entries_[0], entries_[0]});
  EXPECT_THAT(twice.status().message(), HasSubstr("'b' is listed twice"));
  EXPECT_FALSE(SafetensorsStream::Create((folder_ / "no/such").string(), {}, entries_).ok());
}

}  // namespace
}  // namespace robostress
