#include "adapter/thrown_status.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <functional>
#include <new>
#include <stdexcept>

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

absl::Status Of(const std::function<void()>& work) {
  try {
    work();
  } catch (const std::exception& error) {
    return ThrownStatus("update 7", error);
  }
  return absl::OkStatus();
}

TEST(ThrownStatus, TellsMissingMemoryFromEverythingElseAndKeepsNoStack) {
  for (const absl::Status& status : {Of([] { throw std::bad_alloc(); }),
                                     Of([] { torch::empty({int64_t{1} << 46}, torch::kUInt8); })}) {
    EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr("update 7: not enough memory"));
    EXPECT_THAT(std::string(status.message()), Not(HasSubstr("frame #")));
  }
  const absl::Status shapes = Of([] { torch::matmul(torch::ones({2, 3}), torch::ones({2, 3})); });
  EXPECT_EQ(shapes.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(shapes.message()), Not(HasSubstr("frame #")));
  EXPECT_EQ(Of([] { throw std::runtime_error("shape"); }).code(), absl::StatusCode::kInternal);
}

}  // namespace
}  // namespace robostress
