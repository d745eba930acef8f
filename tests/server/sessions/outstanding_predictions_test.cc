#include "server/sessions/outstanding_predictions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "server/sessions/state_rules.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

Prediction Of(uint64_t id, const ChunkKey& key = {}) { return {.id = id, .key = key}; }

// As a session does: numbers in order.
OutstandingPredictions Made(int count) {
  OutstandingPredictions predictions;
  for (int i = 0; i < count; ++i) predictions.Keep(Of(*predictions.Next(), {{1, 2}, i}));
  return predictions;
}

ExecutedChunk Report(uint64_t prediction, const ChunkKey& key) {
  ExecutedChunk chunk;
  chunk.sequence = 7;
  chunk.prediction_id = prediction;
  chunk.task = key.episode.task;
  chunk.episode = key.episode.episode;
  chunk.chunk = key.chunk;
  return chunk;
}

TEST(OutstandingPredictions, CountsFromOneAndDropsTheOldestBeyondSixtyFour) {
  OutstandingPredictions predictions = Made(66);
  EXPECT_EQ(predictions.last(), 66u);
  EXPECT_EQ(predictions.made(), 66u);
  EXPECT_EQ(predictions.dropped(), 2u);
  EXPECT_EQ(predictions.Kept().size(), OutstandingPredictions::kMost);
  EXPECT_FALSE(predictions.Holds(2));
  EXPECT_EQ((*predictions.Find(3))->id, 3u);
  EXPECT_EQ((*predictions.Find(0))->id, 66u) << "0 is the newest";
  EXPECT_THAT(std::string(predictions.Find(2).status().message()),
              HasSubstr("prediction 2 is not one that this session holds; it made 66, keeps the "
                        "last 64 and none that is older than one already reported"));
}

TEST(OutstandingPredictions, AReportMustBeOfThePredictionsOwnEpisodeAndChunk) {
  OutstandingPredictions predictions = Made(3);
  EXPECT_EQ((*predictions.ReportedBy(Report(2, {{1, 2}, 1})))->id, 2u);
  for (const ChunkKey& other : {ChunkKey{{0, 2}, 1}, ChunkKey{{1, 3}, 1}, ChunkKey{{1, 2}, 0}}) {
    const absl::Status status = predictions.ReportedBy(Report(2, other)).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_THAT(std::string(status.message()), HasSubstr("was made for task 1 episode 2 chunk 1"));
  }
  EXPECT_THAT(std::string(predictions.ReportedBy(Report(9, {})).status().message()),
              HasSubstr("feedback 7 is about prediction 9, which this session does not hold"));
}

TEST(OutstandingPredictions, WhatIsOlderThanAReportedOneIsForgottenAndTheReportedOneStays) {
  OutstandingPredictions predictions = Made(5);
  predictions.Settle(3);
  EXPECT_FALSE(predictions.Holds(2));
  EXPECT_TRUE(predictions.Holds(3)) << "the rest of it may be reported later";
  EXPECT_EQ(predictions.dropped(), 0u);
}

TEST(OutstandingPredictions, NumbersGoOnAfterThoseOfAJournalAndEnd) {
  OutstandingPredictions predictions;
  ASSERT_TRUE(predictions.Skip(41).ok());
  ASSERT_TRUE(predictions.Skip(7).ok());
  EXPECT_EQ(*predictions.Next(), 42u);
  EXPECT_FALSE(predictions.Skip(StateRules::kMaxCount).ok());
  ASSERT_TRUE(predictions.Skip(StateRules::kMaxCount - 1).ok());
  EXPECT_EQ(predictions.Next().status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(OutstandingPredictions, ASnapshotThatFailedLeavesTheirRecordsAsTheyWere) {
  OutstandingPredictions predictions = Made(2);
  const std::vector<Prediction> before = predictions.Kept();
  predictions.MarkJournaled();
  predictions.Keep(Of(*predictions.Next()));
  EXPECT_TRUE((*predictions.Find(1))->journaled);
  predictions.Settle(2);
  predictions.MarkAsIn(before);
  EXPECT_FALSE((*predictions.Find(2))->journaled);
  OutstandingPredictions restored;
  restored.Restore(predictions.Kept(), predictions.next(), 3, 1);
  EXPECT_EQ(*restored.Next(), 4u);
  EXPECT_EQ(restored.made(), 3u);
  EXPECT_EQ(restored.dropped(), 1u);
}

}  // namespace
}  // namespace robostress
