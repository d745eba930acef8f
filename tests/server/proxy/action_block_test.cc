#include "server/proxy/action_block.h"

#include <gtest/gtest.h>

#include <limits>

#include "tests/server/proxy/proxy_messages.h"

namespace robostress {
namespace {

TEST(ActionBlock, FindsFloatsAndDoublesWhereverAServerPutsThem) {
  const std::vector<double> action = {0.5, -1, 0.25};
  std::vector<float> floats(6);
  std::vector<double> doubles(6);
  for (size_t i = 0; i < 6; ++i) floats[i] = static_cast<float>(doubles[i] = action[i % 3]);
  OpenpiBytes bare, alone, batch;
  bare.Numbers<float>("<f4", {2, 3}, floats);
  alone.Map(1).Text("whatever").Numbers<double>("<f8", {2, 3}, doubles);
  batch.Map(1).Text("actions").Numbers<float>("<f4", {1, 2, 3}, floats);
  for (const std::string& answer :
       {bare.bytes(), alone.bytes(), batch.bytes(), ActionAnswer<float>(action, 2),
        ActionAnswer<double>(action, 2)}) {
    const auto block = FindActions(answer);
    ASSERT_TRUE(block.ok()) << block.status();
    EXPECT_EQ(block->rows, 2);
    EXPECT_EQ(block->cols, 3);
    const Eigen::MatrixXd read = ReadActions(answer, *block);
    EXPECT_EQ(read(1, 0), 0.5);
    EXPECT_EQ(read(0, 1), -1);
    EXPECT_EQ(read(1, 2), 0.25);
  }
}

TEST(ActionBlock, ChangesTheBytesOfOneNumberAndNoOther) {
  for (const bool doubles : {false, true}) {
    const std::string answer =
        doubles ? ActionAnswer<double>({1, 2, 3}, 4) : ActionAnswer<float>({1, 2, 3}, 4);
    const auto block = FindActions(answer);
    ASSERT_TRUE(block.ok());
    std::string changed = answer;
    EXPECT_EQ(WriteAction(changed, *block, 2, 1, -7.5), -7.5);
    ASSERT_EQ(changed.size(), answer.size());
    const size_t begin = block->offset + (2 * 3 + 1) * block->item;
    for (size_t i = 0; i < answer.size(); ++i) {
      if (i < begin || i >= begin + block->item) {
        ASSERT_EQ(changed[i], answer[i]) << i;
      }
    }
    Eigen::MatrixXd expected = ReadActions(answer, *block);
    expected(2, 1) = -7.5;
    EXPECT_EQ(ReadActions(changed, *block), expected);
  }
}

TEST(ActionBlock, RefusesWhatIsNoChunkOfFloats) {
  OpenpiBytes named, error, integers, flat;
  named.Map(2).Text("left").Numbers<float>("<f4", {1, 1}, {1.f});
  named.Text("right").Numbers<float>("<f4", {1, 1}, {1.f});
  error.Map(2).Text("type").Text("error").Text("message").Text("no");
  integers.Map(1).Text("actions").Numbers<int32_t>("<i4", {1, 2}, {1, 2});
  flat.Map(1).Text("actions").Numbers<float>("<f4", {2}, {1.f, 2.f});
  EXPECT_EQ(FindActions(named.bytes()).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(FindActions(error.bytes()).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(FindActions(flat.bytes()).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(FindActions("garbage").status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(FindActions("").status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(FindActions(integers.bytes()).status().code(), absl::StatusCode::kUnimplemented);
}

}  // namespace
}  // namespace robostress
