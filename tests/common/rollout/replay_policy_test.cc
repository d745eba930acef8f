#include "common/rollout/replay_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <limits>

#include "common/atomic_file.h"
#include "common/safetensors.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string TempFile(const std::string& name) {
  return (std::filesystem::path(testing::TempDir()) / name).string();
}

std::string WriteActions(const std::string& name, std::vector<int64_t> shape,
                         const std::vector<float>& values) {
  SafetensorsWriter writer;
  writer.AddFloats("actions", std::move(shape), values);
  const std::string file = TempFile(name);
  EXPECT_TRUE(writer.Write(file).ok());
  return file;
}

std::vector<float> Ramp(int rows) {
  std::vector<float> values;
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < 7; ++c)
      values.push_back(static_cast<float>(r) + 0.125f * static_cast<float>(c));
  }
  return values;
}

TEST(ReplayPolicyTest, PlaysRowsInOrderThenHoldsStillWithTheLastGripperCommand) {
  auto policy = MakeReplayPolicy(WriteActions("replay.safetensors", {7, 7}, Ramp(7)));
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_TRUE((*policy)->spec().cameras.empty());
  EXPECT_EQ((*policy)->spec().model_hash.size(), 64u);
  const auto first = (*policy)->Predict({}, 0), second = (*policy)->Predict({}, 1),
             third = (*policy)->Predict({}, 2);
  ASSERT_TRUE(first.ok() && second.ok() && third.ok());
  EXPECT_EQ(first->actions(4, 2), 4.25f);
  EXPECT_EQ(second->actions(1, 0), 6.0f);
  for (const auto& [chunk, row] : {std::pair{&*second, 2}, std::pair{&*third, 4}}) {
    EXPECT_EQ(chunk->actions.row(row).head(6).norm(), 0);
    EXPECT_EQ(chunk->actions(row, 6), 6.75f);
  }
  EXPECT_EQ(first->policy_actions, first->actions);
}

TEST(ReplayPolicyTest, RefusesFilesThatHoldNoCommands) {
  std::vector<float> broken = Ramp(2);
  broken[9] = std::numeric_limits<float>::quiet_NaN();
  const std::string garbage = TempFile("garbage.safetensors");
  ASSERT_TRUE(WriteFileAtomically(garbage, "not safetensors").ok());
  const std::pair<std::string, const char*> cases[] = {
      {"", "policy replay needs replay_file"},
      {TempFile("absent.safetensors"), "absent.safetensors"},
      {garbage, "garbage.safetensors"},
      {WriteActions("wide.safetensors", {2, 8}, std::vector<float>(16)), "actions"},
      {WriteActions("empty.safetensors", {0, 7}, {}), "has no rows"},
      {WriteActions("nan.safetensors", {2, 7}, broken), "actions[1,2] is nan, must be finite"},
  };
  for (const auto& [file, message] : cases) {
    const auto policy = MakeReplayPolicy(file);
    ASSERT_FALSE(policy.ok()) << file;
    EXPECT_THAT(std::string(policy.status().message()), HasSubstr(message));
  }
}

}  // namespace
}  // namespace robostress
