#include "server/sessions/read_spec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace robostress {
namespace {

using ::testing::HasSubstr;

RequestedSession Request(const std::string& method) {
  RequestedSession request;
  request.suite = "tabletop_goal";
  request.seed = -5;
  request.method_yaml = method;
  return request;
}

TEST(ReadSpec, AMethodsNameAloneIsItsWholePresetAndTheRestIsTheRequests) {
  const auto spec = ReadSpec(Request("method: ours"));
  ASSERT_TRUE(spec.ok()) << spec.status();
  EXPECT_EQ(DumpConfig(*spec->method), DumpConfig(*MakeMethod("ours")));
  EXPECT_EQ(spec->suite, "tabletop_goal");
  EXPECT_EQ(spec->seed, -5);
  EXPECT_EQ(RequestOf(*spec).method_yaml, DumpConfig(*MakeMethod("ours")));
  EXPECT_EQ(RequestOf(*spec).seed, -5);
}

// What a server of an older version stored knew nothing of later options, and had none of them.
TEST(ReadSpec, WhatIsStoredTakesNothingFromItsPreset) {
  const RequestedSession old = Request("{method: ours_integral, integral_rate: 0.01}");
  const auto stored = ReadStoredSpec(old);
  ASSERT_TRUE(stored.ok()) << stored.status();
  EXPECT_EQ(stored->method->Find<IntegralOptions>()->rate, 0.01);
  EXPECT_FALSE(stored->method->Find<IntegralOptions>()->carry);
  EXPECT_TRUE(ReadSpec(old)->method->Find<IntegralOptions>()->carry);
}

TEST(ReadSpec, NamesTheFieldOfWhatItRefuses) {
  for (const char* method : {"", "adapt: true", "method: magic", "{method: ours, learning_rat: 1}",
                             "{method: ours, integral_limit: 0.3}", "learning_rate: [1"}) {
    const absl::Status status = ReadSpec(Request(method)).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << method;
    EXPECT_THAT(std::string(status.message()), HasSubstr("spec.method_yaml: ")) << method;
  }
}

}  // namespace
}  // namespace robostress
