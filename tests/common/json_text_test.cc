#include "common/json_text.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string ErrorOf(const std::string& text) {
  const auto json = ParseJsonObject(text);
  return json.ok() ? "" : std::string(json.status().message());
}

TEST(JsonText, ObjectsAreParsed) {
  const auto json = ParseJsonObject(R"({"a": [1, {"b": "[[[[\"{"}], "c": {"b": 2}})");
  ASSERT_TRUE(json.ok()) << json.status();
  EXPECT_EQ((*json)["a"][1]["b"], "[[[[\"{");
}

TEST(JsonText, OtherTextRepeatedKeysAndDepthAreRefused) {
  for (const char* text : {"", "[1]", "3", "{\"a\": 1", "{\"a\": 1e999}", "{\"a\": NaN}"}) {
    EXPECT_EQ(ErrorOf(text), "it is not a JSON object") << text;
  }
  EXPECT_THAT(ErrorOf(R"({"a": {"k": 1, "k": 2}})"), HasSubstr("key 'k' occurs twice"));
  EXPECT_EQ(ErrorOf(R"({"a": {"k": 1}, "b": {"k": 2}})"), "");
  EXPECT_THAT(ErrorOf("{\"a\": " + std::string(50, '[') + std::string(50, ']') + "}"),
              HasSubstr("nested 51 deep"));
  EXPECT_THAT(ErrorOf(std::string(8'000'000, '[')), HasSubstr("the limit is 16"));
}

TEST(TextAt, IsEmptyWhereThereIsNoText) {
  const nlohmann::json json = {{"text", "a"}, {"number", 5}, {"nothing", nullptr}};
  EXPECT_EQ(TextAt(json, "text"), "a");
  for (const char* key : {"number", "nothing", "absent"}) EXPECT_EQ(TextAt(json, key), "");
  for (const nlohmann::json& other : {nlohmann::json(), nlohmann::json(5), nlohmann::json::array()})
    EXPECT_EQ(TextAt(other, "text"), "");
}

}  // namespace
}  // namespace robostress
