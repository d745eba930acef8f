#include "common/safetensors.h"

#include <cstring>
#include <filesystem>

#include "common/random.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string File(const std::string& header, const std::string& data) {
  const uint64_t size = header.size();
  return std::string(reinterpret_cast<const char*>(&size), 8) + header + data;
}

std::string ErrorOf(std::string bytes) {
  const auto file = SafetensorsFile::Parse("x.safetensors", std::move(bytes));
  return file.ok() ? "" : std::string(file.status().message());
}

TEST(Safetensors, WrittenTensorsAndMetadataReadBack) {
  SafetensorsWriter writer;
  writer.SetMetadata("model", "nano");
  const std::vector<float> values = {1.5f, -2.25f, 3e-20f, 0, 5, 6};
  writer.AddFloats("w", {2, 3}, values);
  const std::vector<double> doubles = {0.1};
  writer.AddDoubles("d", {}, doubles);
  const std::vector<uint8_t> bytes = {1, 2, 3};
  writer.Add("u", DType::kU8, {3}, bytes.data(), 3);
  const std::string path = ::testing::TempDir() + "round_trip.safetensors";
  ASSERT_TRUE(writer.Write(path).ok());
  const auto file = SafetensorsFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->metadata().at("model"), "nano");
  EXPECT_EQ(*file->ReadFloats("w", {2, -1}), values);
  EXPECT_EQ(*file->ReadDoubles("d"), doubles);
  EXPECT_EQ(file->Get("u")->shape, (std::vector<int64_t>{3}));
  EXPECT_FALSE(file->ReadFloats("w", {3, 2}).ok());
  EXPECT_FALSE(file->Get("nothing").ok());
  std::filesystem::remove(path);
}

TEST(Safetensors, HalfPrecisionFormatsConvertExactly) {
  const uint16_t half[] = {0x3C00, 0xC000, 0x0001, 0x7BFF, 0x8000};
  const uint16_t brain[] = {0x3F80, 0xC040};
  SafetensorsWriter writer;
  writer.Add("h", DType::kF16, {5}, half, sizeof(half));
  writer.Add("b", DType::kBF16, {2}, brain, sizeof(brain));
  const auto file = SafetensorsFile::Parse("half", *writer.Serialize());
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(*file->ReadDoubles("h"), (std::vector<double>{1, -2, 0x1p-24, 65504, -0.0}));
  EXPECT_EQ(*file->ReadDoubles("b"), (std::vector<double>{1, -3}));
}

TEST(Safetensors, HostileHeadersAreNamed) {
  EXPECT_THAT(ErrorOf(""), HasSubstr("0 bytes"));
  EXPECT_THAT(ErrorOf(std::string(8, '\xff')), HasSubstr("header length"));
  EXPECT_THAT(ErrorOf(File("[]", "")), HasSubstr("not a JSON object"));
  EXPECT_THAT(ErrorOf(File("{\"a\":", "")), HasSubstr("not a JSON object"));
  EXPECT_THAT(ErrorOf(File(R"({"a":3})", "")), HasSubstr("'a'"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[1]}})", "")),
              HasSubstr("no data_offsets"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F99","shape":[1],"data_offsets":[0,4]}})", "1234")),
              HasSubstr("F99"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})", "1234")),
              HasSubstr("truncated"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,4]}})", "1234")),
              HasSubstr("does not fill"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[-1],"data_offsets":[0,4]}})", "1234")),
              HasSubstr("-1"));
  EXPECT_THAT(
      ErrorOf(File(
          R"({"a":{"dtype":"U8","shape":[281474976710656,281474976710656],"data_offsets":[0,4]}})",
          "1234")),
      HasSubstr("does not fill"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[1],"data_offsets":[4,0]}})", "1234")),
              HasSubstr("[4, 0]"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}})", "12345")),
              HasSubstr("no tensor"));
  EXPECT_THAT(
      ErrorOf(File(
          R"({"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]},"b":{"dtype":"U8","shape":[2],"data_offsets":[1,3]}})",
          "123")),
      HasSubstr("two tensors"));
  EXPECT_THAT(
      ErrorOf(File(
          R"({"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]},"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]}})",
          "1")),
      HasSubstr("occurs twice"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"U8","shape":[1],"data_offsets":[1,2]}})", "12")),
              HasSubstr("data bytes 0 to 1 belong to no tensor"));
  EXPECT_THAT(ErrorOf(File(R"({"__metadata__":{"k":1}})", "")), HasSubstr("'k'"));
  EXPECT_THAT(ErrorOf(File(R"({"__metadata__":"k"})", "")),
              HasSubstr("__metadata__ \"k\" is not an object"));
}

TEST(Safetensors, EveryTruncationIsRefused) {
  SafetensorsWriter writer;
  const std::vector<float> values(16, 1.0f);
  writer.AddFloats("w", {16}, values);
  const std::string bytes = *writer.Serialize();
  for (size_t size = 0; size < bytes.size(); ++size)
    EXPECT_NE(ErrorOf(bytes.substr(0, size)), "") << size;
}

TEST(Safetensors, RandomDamageNeverCrashes) {
  SafetensorsWriter writer;
  const std::vector<float> values(4, 1.0f);
  writer.AddFloats("weights", {2, 2}, values);
  const std::string bytes = *writer.Serialize();
  RandomStream stream{StreamKey("damage")};
  for (int i = 0; i < 5000; ++i) {
    std::string damaged = bytes;
    for (int k = stream.UniformInt(4); k >= 0; --k) {
      damaged[stream.UniformInt(static_cast<int>(damaged.size()))] =
          static_cast<char>(stream.UniformInt(256));
    }
    const auto file = SafetensorsFile::Parse("damaged", damaged);
    if (file.ok()) {
      for (const auto& [name, view] : file->tensors()) EXPECT_TRUE(file->ReadDoubles(name).ok());
    }
  }
}

TEST(Safetensors, MissingFileIsNamed) {
  const auto file = SafetensorsFile::Open("does/not/exist.safetensors");
  ASSERT_FALSE(file.ok());
  EXPECT_THAT(std::string(file.status().message()), HasSubstr("does/not/exist.safetensors"));
}

}  // namespace
}  // namespace robostress
