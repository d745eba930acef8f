#include "adapter/update_schedule.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "adapter/feedback_buffer.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;

std::vector<int> Triggers(UpdateSchedule& schedule, int chunks) {
  std::vector<int> triggers;
  for (int i = 1; i <= chunks; ++i) {
    if (schedule.Add()) triggers.push_back(i);
  }
  return triggers;
}

TEST(UpdateSchedule, TriggersWhenTheBufferIsFullAndEveryEighthChunkAfterThat) {
  UpdateSchedule schedule(32, 8);
  EXPECT_THAT(Triggers(schedule, 63), ElementsAre(32, 40, 48, 56));
}

TEST(UpdateSchedule, StartsAnewAfterAClear) {
  UpdateSchedule schedule(32, 8);
  Triggers(schedule, 45);
  schedule.Clear();
  EXPECT_THAT(Triggers(schedule, 50), ElementsAre(32, 40, 48));
}

TEST(FeedbackBuffer, KeepsTheMostRecentItemsOldestFirst) {
  FeedbackBuffer<int> buffer(3);
  for (int i = 0; i < 5; ++i) buffer.Add(i);
  ASSERT_EQ(buffer.size(), 3);
  EXPECT_EQ(buffer[0], 2);
  EXPECT_EQ(buffer[2], 4);
  buffer.Clear();
  EXPECT_EQ(buffer.size(), 0);
}

TEST(SampleWithoutReplacement, NeverDrawsAnIndexTwice) {
  for (int i = 0; i < 200; ++i) {
    const std::vector<int> sample =
        SampleWithoutReplacement(StreamKey("t").With(int64_t{i}), 32, 4);
    EXPECT_EQ(std::set<int>(sample.begin(), sample.end()).size(), 4u);
    for (const int index : sample) EXPECT_TRUE(index >= 0 && index < 32);
  }
}

TEST(SampleWithoutReplacement, IsAFunctionOfItsKey) {
  const StreamKey key = StreamKey("session").With("a");
  EXPECT_EQ(SampleWithoutReplacement(key, 32, 4), SampleWithoutReplacement(key, 32, 4));
  EXPECT_NE(SampleWithoutReplacement(key, 32, 4),
            SampleWithoutReplacement(StreamKey("session").With("b"), 32, 4));
}

TEST(SampleWithoutReplacement, DrawsEveryIndexEquallyOften) {
  // 4000 draws of 4 of 8: each index is expected 2000 times with a standard deviation of 32.
  std::vector<int> counts(8, 0);
  for (int i = 0; i < 4000; ++i) {
    for (const int index : SampleWithoutReplacement(StreamKey("u").With(int64_t{i}), 8, 4))
      ++counts[index];
  }
  for (const int count : counts) EXPECT_NEAR(count, 2000, 5 * 32);
}

TEST(SampleWithoutReplacement, OfEverythingIsAPermutation) {
  const std::vector<int> all = SampleWithoutReplacement(StreamKey("p"), 6, 6);
  EXPECT_EQ(std::set<int>(all.begin(), all.end()).size(), 6u);
}

}  // namespace
}  // namespace robostress
