#include "common/wire/openpi_value.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <limits>

#include "absl/strings/escaping.h"
#include "common/wire/openpi_observation.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "tests/common/wire/openpi_bytes.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string Refusal(const std::string& bytes) {
  const auto decoded = DecodeOpenpi(bytes);
  EXPECT_FALSE(decoded.ok());
  EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(decoded.status().message());
}

TEST(OpenpiWriter, WritesTheDocumentedBytesOfAnArray) {
  Eigen::MatrixXf matrix(1, 2);
  matrix << 1, 2;
  EXPECT_EQ(absl::BytesToHexString(OpenpiWriter().Array(matrix).Take()),
            "84c40b5f5f6e6461727261795f5fc3c40464617461c4080000803f00000040"
            "c4056474797065a33c6634c40573686170659201"
            "02");
}

TEST(DecodeOpenpi, ReadsTheDocumentedBytesWithKeysOfEitherKind) {
  for (const char* key : {"c4", "text"}) {
    OpenpiBytes message;
    message.Map(1).Text("a");
    if (std::string(key) == "c4") {
      message.Numbers<float>("<f4", {1, 2}, {1, 2});
    } else {
      message.Map(4).Text("__ndarray__").True().Text("data");
      message.Bin(std::string("\0\0\x80\x3f\0\0\0\x40", 8)).Text("dtype").Text("<f4").Text("shape");
      message.Byte(0x92).Integer(1).Integer(2);
    }
    const auto decoded = DecodeOpenpi(message.bytes());
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_THAT(*OpenpiNumbers("a", *decoded->Find("a"), 8), ElementsAre(1, 2)) << key;
  }
}

TEST(DecodeOpenpi, TakesEveryNumericKindAndNumpyScalars) {
  OpenpiBytes message;
  message.Map(4);
  message.Text("i8").Numbers<int64_t>("<i8", {2}, {-3, 4});
  message.Text("u1").Numbers<uint8_t>("|u1", {2}, {7, 255});
  message.Text("b1").Numbers<uint8_t>("|b1", {1}, {1});
  message.Text("scalar").Map(3).Bin("__npgeneric__").True().Bin("data").Integer(9).Bin("dtype");
  message.Text("<i8");
  const auto decoded = DecodeOpenpi(message.bytes());
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_THAT(*OpenpiNumbers("i8", *decoded->Find("i8"), 8), ElementsAre(-3, 4));
  EXPECT_THAT(*OpenpiNumbers("u1", *decoded->Find("u1"), 8), ElementsAre(7, 255));
  EXPECT_THAT(*OpenpiNumbers("b1", *decoded->Find("b1"), 8), ElementsAre(1));
  EXPECT_EQ(*OpenpiInteger("scalar", *decoded->Find("scalar"), 0, 10), 9);
}

TEST(DecodeOpenpi, RefusesWhatIsNoWholeMap) {
  const std::string whole = OpenpiBytes().Map(1).Text("a").Numbers<float>("<f4", {1}, {1}).bytes();
  for (size_t size = 0; size < whole.size(); ++size)
    EXPECT_FALSE(DecodeOpenpi(std::string_view(whole).substr(0, size)).ok()) << size << " bytes";
  EXPECT_THAT(Refusal(whole + "x"), HasSubstr("1 bytes follow the map"));
  EXPECT_THAT(Refusal(OpenpiBytes().Text("hello").bytes()), HasSubstr("is no map"));
  EXPECT_THAT(Refusal("\xc1"), HasSubstr("no msgpack at byte 0"));
}

TEST(DecodeOpenpi, NamesTheArrayThatLies) {
  const auto with = [](const std::string& dtype, const std::vector<int>& shape,
                       const std::string& data) {
    return Refusal(OpenpiBytes().Map(1).Text("image").Array(dtype, shape, data).bytes());
  };
  EXPECT_THAT(with("<f4", {3}, "12345678"), HasSubstr("image holds 8 bytes"));
  EXPECT_THAT(with("<f4", {3}, "12345678"), HasSubstr("shape [3] need 12"));
  EXPECT_THAT(with("|O", {1}, "12345678"), HasSubstr("image has dtype '|O'"));
  EXPECT_THAT(with(">f4", {1}, "1234"), HasSubstr("little-endian"));
  EXPECT_THAT(with("<c8", {1}, "12345678"), HasSubstr("dtype '<c8'"));
  EXPECT_THAT(with("<f8", {1 << 30, 1 << 30}, ""), HasSubstr("more than 4 GiB"));
}

TEST(DecodeOpenpi, RefusesTwoEqualKeysExtensionsAndWhatGrows) {
  EXPECT_THAT(Refusal(OpenpiBytes().Map(2).Text("a").Integer(1).Bin("a").Integer(2).bytes()),
              HasSubstr("a occurs twice"));
  EXPECT_THAT(Refusal(OpenpiBytes().Map(1).Text("a").Byte(0xd4).Byte(1).Byte(2).bytes()),
              HasSubstr("a is a msgpack extension"));
  EXPECT_THAT(Refusal(OpenpiBytes().Map(1).Integer(3).Integer(4).bytes()), HasSubstr("key"));
  OpenpiBytes deep;
  for (int i = 0; i < 100; ++i) deep.Map(1).Text("a");
  EXPECT_THAT(Refusal(deep.bytes()), HasSubstr("nested deeper than 8"));
  OpenpiBytes wide;  // a header that claims 2^32 - 1 values costs nothing until they come
  wide.Map(1).Text("a").Byte(0xdd).Big(0xffffffff, 4);
  EXPECT_FALSE(DecodeOpenpi(wide.bytes()).ok());
  wide = {};
  wide.Map(1).Text("a").Byte(0xdd).Big(30000, 4);
  for (int i = 0; i < 30000; ++i) wide.Integer(1);
  EXPECT_THAT(Refusal(wide.bytes()), HasSubstr("one value too many"));
}

// Most that this process held since the last call, [MiB].
double PeakMib() {
  std::ifstream status("/proc/self/status");
  double kib = 0;
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) kib = std::stod(line.substr(6));
  }
  std::ofstream("/proc/self/clear_refs") << "5";
  return kib / 1024;
}

TEST(OpenpiReaders, RefuseByTheShapeBeforeTheyConvert) {
  constexpr int kMib = 63;
  OpenpiBytes message;
  message.Map(3).Text("u1").Array("|u1", {kMib << 20}, std::string(size_t{kMib} << 20, 1));
  message.Text("rows").Array("|u1", {1 << 10, 1 << 10}, std::string(1 << 20, 1));
  message.Text("text").Bin(std::string(1 << 20, 'x'));
  const auto decoded = DecodeOpenpi(message.bytes());
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  const auto refused = [](const auto& result) { return std::string(result.status().message()); };
  PeakMib();
  const double before = PeakMib();
  EXPECT_EQ(OpenpiCount(*decoded->Find("u1")), size_t{kMib} << 20);
  EXPECT_THAT(refused(OpenpiNumbers("state", *decoded->Find("u1"), 8)),
              HasSubstr("state: holds 66060288 numbers, must hold at most 8"));
  EXPECT_THAT(refused(OpenpiMatrix("q", *decoded->Find("u1"), {2, 51}, {1, 64})),
              HasSubstr("q: has shape [66060288], must be an array of shape [2..51, 1..64]"));
  EXPECT_THAT(refused(OpenpiMatrix("q", *decoded->Find("rows"), {2, 51}, 7)),
              HasSubstr("q: has shape [1024, 1024], must be an array of shape [2..51, 7]"));
  EXPECT_THAT(refused(OpenpiText("id", *decoded->Find("text"), 256)),
              HasSubstr("id: has 1048576 bytes, must be a text of at most 256 bytes"));
  PolicySpec policy;
  policy.horizon = 50;
  policy.cameras = {"u1", "rows"};
  for (const bool asked : {false, true}) {
    EXPECT_FALSE(ReadOpenpiObservation(*decoded, policy, {.default_prompt = "p"}, asked).ok());
  }
  EXPECT_LT(PeakMib() - before, 1) << "something was allocated for what is refused";
}

TEST(OpenpiNumbers, RefusesWhatIsNotFiniteWithItsPlace) {
  const OpenpiBytes message =
      OpenpiBytes().Map(1).Text("state").Numbers<double>("<f8", {3}, {1, std::nan(""), 2});
  const auto decoded = DecodeOpenpi(message.bytes());
  ASSERT_TRUE(decoded.ok());
  EXPECT_THAT(std::string(OpenpiNumbers("state", *decoded->Find("state"), 8).status().message()),
              HasSubstr("state[1] is nan, must be finite"));
}

}  // namespace
}  // namespace robostress
