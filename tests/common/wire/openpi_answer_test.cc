#include "common/wire/openpi_answer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/common/wire/openpi_bytes.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

absl::StatusOr<OpenpiAnswer> Read(const std::string& bytes) {
  const auto value = DecodeOpenpiValue(bytes);
  EXPECT_TRUE(value.ok()) << value.status();
  return ReadOpenpiAnswer(*value, {1, 4}, 3);
}
std::string Refusal(const OpenpiBytes& bytes) {
  const auto answer = Read(bytes.bytes());
  EXPECT_EQ(answer.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(answer.status().message());
}
const std::vector<double> kRows = {1, 2, 3, 4, 5, 6};

TEST(OpenpiAnswer, TakesWhatOpenpiAndItsRelativesAnswer) {
  const std::vector<float> floats(kRows.begin(), kRows.end());
  OpenpiBytes map, timed;
  map.Map(1).Text("actions").Numbers<double>("<f8", {2, 3}, kRows);
  timed.Map(3).Text("actions").Numbers<float>("<f4", {2, 3}, floats).Text("unknown").True();
  timed.Text("policy_timing").Map(1).Text("infer_ms").Byte(0xcb).Big(0x4028000000000000, 8);  // 12
  OpenpiBytes other;
  other.Map(1).Text("arm").Numbers<float>("<f4", {2, 3}, floats);
  for (const std::string& bytes :
       {map.bytes(), timed.bytes(), other.bytes(),
        OpenpiBytes().Numbers<float>("<f4", {2, 3}, floats).bytes(),
        OpenpiBytes().Numbers<float>("<f4", {1, 2, 3}, floats).bytes()}) {
    const auto answer = Read(bytes);
    ASSERT_TRUE(answer.ok()) << answer.status();
    ASSERT_EQ(answer->actions.rows(), 2);
    ASSERT_EQ(answer->actions.cols(), 3);
    EXPECT_EQ(answer->actions(0, 2), 3);
    EXPECT_EQ(answer->actions(1, 0), 4);
  }
  EXPECT_EQ(Read(timed.bytes())->infer_ms, 12);
  EXPECT_EQ(Read(map.bytes())->infer_ms, 0);
}

TEST(OpenpiAnswer, ATimeThatCannotBeIsNone) {
  for (const uint64_t bits : {0x7ff0000000000000u, 0xfff0000000000000u, 0x7ff8000000000000u,
                              0xc028000000000000u}) {  // infinite, nan, -12
    OpenpiBytes bytes;
    bytes.Map(2).Text("actions").Numbers<double>("<f8", {2, 3}, kRows);
    bytes.Text("policy_timing").Map(1).Text("infer_ms").Byte(0xcb).Big(bits, 8);
    const auto answer = Read(bytes.bytes());
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(answer->infer_ms, 0);
  }
}

TEST(OpenpiAnswer, ShowsWhatCameAndWhatWasExpected) {
  const auto actions = [](const std::vector<int>& shape, const std::vector<double>& values) {
    OpenpiBytes bytes;
    bytes.Map(1).Text("actions").Numbers<double>("<f8", shape, values);
    return bytes;
  };
  EXPECT_THAT(Refusal(actions({3, 2}, kRows)),
              HasSubstr("actions: has shape [3, 2], must be an array of shape [1..4, 3]"));
  EXPECT_THAT(Refusal(actions({5, 3}, std::vector<double>(15))), HasSubstr("has shape [5, 3]"));
  EXPECT_THAT(Refusal(actions({2, 1, 3}, kRows)), HasSubstr("has shape [2, 1, 3]"));
  EXPECT_THAT(Refusal(actions({0, 3}, {})), HasSubstr("has shape [0, 3]"));
  EXPECT_THAT(Refusal(actions({1, 3}, {1, std::nan(""), 3})),
              HasSubstr("actions[1] is nan, must be finite"));
  EXPECT_THAT(Refusal(actions({1, 3}, {1, 2, 1e300})), HasSubstr("beyond float32"));
  OpenpiBytes named;
  named.Map(2).Text("arm").Numbers<double>("<f8", {2, 3}, kRows).Text("hand").True();
  EXPECT_THAT(Refusal(named), AllOf(HasSubstr("the answer is a map of arm [2, 3], hand;"),
                                    HasSubstr("under 'actions'")));
  EXPECT_THAT(Refusal(OpenpiBytes().Integer(3)), HasSubstr("neither a map nor an array"));
  OpenpiBytes empty;
  empty.Map(0);
  EXPECT_THAT(Refusal(empty), HasSubstr("the answer is an empty map; expected"));
}

TEST(OpenpiAnswer, TellsTheServersOwnWords) {
  OpenpiBytes error;
  error.Map(2).Text("type").Text("error").Text("message").Text("no such\nsession");
  const auto answer = Read(error.bytes());
  EXPECT_EQ(answer.status().code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(answer.status().message()), HasSubstr("refuses: no such session"));
  const absl::Status text = OpenpiErrorText(
      "Traceback (most recent call last):\n  File \"x.py\", line 1\nKeyError: 'state'\n");
  EXPECT_EQ(text.message(), "the policy server failed: KeyError: 'state'");
  EXPECT_LT(OpenpiErrorText(std::string(1 << 20, 'x')).message().size(), 2000u);
}

}  // namespace
}  // namespace robostress
