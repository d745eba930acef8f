#include "common/rollout/chunk_ledger.h"

#include <gtest/gtest.h>

namespace robostress {
namespace {

ExecutedChunk Chunk(uint64_t sequence) {
  ExecutedChunk chunk;
  chunk.sequence = sequence;
  chunk.prediction_id = 100 + sequence;
  return chunk;
}

TEST(ChunkLedgerTest, KeepsChunksUntilTheWatermarkReachesThem) {
  ChunkLedger ledger;
  for (uint64_t i = 1; i <= 5; ++i) ASSERT_TRUE(ledger.Add(Chunk(i)).ok());
  ASSERT_TRUE(ledger.Acknowledge(3).ok());
  ASSERT_EQ(ledger.kept().size(), 2u);
  EXPECT_EQ(ledger.kept().front().sequence, 4u);
  ASSERT_TRUE(ledger.Acknowledge(3).ok());
  EXPECT_EQ(ledger.sent(), 5u);
}

TEST(ChunkLedgerTest, RefusesGapsRepetitionsAndMoreThanItHolds) {
  ChunkLedger ledger(/*capacity=*/2);
  EXPECT_EQ(ledger.Add(Chunk(2)).code(), absl::StatusCode::kFailedPrecondition);
  ASSERT_TRUE(ledger.Add(Chunk(1)).ok());
  EXPECT_FALSE(ledger.Add(Chunk(1)).ok());
  ASSERT_TRUE(ledger.Add(Chunk(2)).ok());
  EXPECT_FALSE(ledger.Add(Chunk(3)).ok());
  EXPECT_EQ(ledger.sent(), 2u);
}

TEST(ChunkLedgerTest, TellsAServerThatLostWhatItAcknowledgedFromOneThatInventsIt) {
  ChunkLedger ledger;
  for (uint64_t i = 1; i <= 3; ++i) ASSERT_TRUE(ledger.Add(Chunk(i)).ok());
  EXPECT_EQ(ledger.Acknowledge(4).code(), absl::StatusCode::kInternal);
  ASSERT_TRUE(ledger.Acknowledge(2).ok());
  EXPECT_EQ(ledger.Acknowledge(1).code(), absl::StatusCode::kDataLoss);
}

TEST(ChunkLedgerTest, AChunkThatIsRefusedForGoodGivesItsNumberToTheNext) {
  ChunkLedger ledger;
  for (uint64_t i = 1; i <= 3; ++i) ASSERT_TRUE(ledger.Add(Chunk(i)).ok());
  ASSERT_TRUE(ledger.Acknowledge(1).ok());
  ledger.DropOldest();
  ASSERT_EQ(ledger.kept().size(), 1u);
  EXPECT_EQ(ledger.kept()[0].sequence, 2u);
  EXPECT_EQ(ledger.kept()[0].prediction_id, 103u);
  EXPECT_TRUE(ledger.Add(Chunk(3)).ok());
  ledger.Restart(40);
  EXPECT_TRUE(ledger.kept().empty());
  EXPECT_TRUE(ledger.Add(Chunk(41)).ok());
}

}  // namespace
}  // namespace robostress
