#include "robot_client/control/chunk_player.h"

#include <gtest/gtest.h>

#include <limits>

namespace robostress {
namespace {

constexpr int64_t kTick_ns = 33'333'333;

// Rows that say where they come from: joints chunk + row / 100, gripper row / 1000.
ArmChunk Chunk(int index, uint64_t played, double base = 0) {
  ArmChunk chunk;
  chunk.chunk = index;
  chunk.played = played;
  chunk.rows = 50;
  for (int i = 0; i < 50; ++i) {
    chunk.requested[i].fill(base + i / 100.0);
    chunk.requested[i][6] = i / 1000.0;
    chunk.policy[i] = chunk.requested[i];
  }
  return chunk;
}

struct Player : ChunkPlayer {
  explicit Player(const PlayerOptions& options = {}) : ChunkPlayer(options, 6) { StartEpisode(0); }
  Step Play() {
    Step step;
    EXPECT_TRUE(Next(step));
    return step;
  }
  ChunkVerdict Take(const ArmChunk& chunk) { return Offer(chunk, 0, {}); }
};

TEST(ChunkPlayerTest, EntersAChunkAtTheRowThatIsDue) {
  Player player;
  ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
  for (int i = 0; i < 12; ++i) EXPECT_EQ(player.Play().row, i);
  // Observed after 10 rows, arrived two rows later.
  ASSERT_EQ(player.Take(Chunk(1, 10)), ChunkVerdict::kTaken);
  const ChunkPlayer::Step step = player.Play();
  EXPECT_EQ(step.row, 2);
  EXPECT_EQ(step.chunk, 1);
  EXPECT_TRUE(step.entered);
}

TEST(ChunkPlayerTest, ExecutesTenRowsPerPredictionAtAConstantLatency) {
  for (const int latency : {0, 1, 3, 8}) {
    Player player;
    ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
    int rows = 0, chunk = 0, first_of_next = -1;
    for (int tick = 0; tick < 200; ++tick) {
      if (tick >= 10 && (tick - latency) % 10 == 0 && tick - latency >= 10) {
        ASSERT_EQ(player.Take(Chunk((tick - latency) / 10, static_cast<uint64_t>(tick - latency))),
                  ChunkVerdict::kTaken);
      }
      const ChunkPlayer::Step step = player.Play();
      if (step.chunk != chunk) {
        if (chunk > 0) {
          EXPECT_EQ(rows, 10) << "latency " << latency;
        }
        chunk = step.chunk;
        rows = 0;
        first_of_next = step.row;
        EXPECT_EQ(first_of_next, latency);
      }
      ++rows;
      EXPECT_FALSE(step.overrun && chunk > 0);
    }
  }
}

TEST(ChunkPlayerTest, NoRowFallsDueWhileTheArmHolds) {
  Player player;
  ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
  for (int i = 0; i < 20; ++i) player.Play();
  ChunkPlayer::Step step;
  for (int i = 0; i < 30; ++i)
    EXPECT_FALSE(player.Next(step)) << "rows from 20 on are never played";
  ASSERT_EQ(player.Take(Chunk(1, 20)), ChunkVerdict::kTaken);
  EXPECT_EQ(player.Play().row, 0);
}

TEST(ChunkPlayerTest, ALateChunkTakesTheOffsetOverAndFadesItOutLinearly) {
  Player player({.fade_steps = 4});
  ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
  for (int i = 0; i < 12; ++i) player.Play();
  ASSERT_EQ(player.Take(Chunk(1, 10, 0.3)), ChunkVerdict::kTaken);
  // Row 12 of the old chunk would have been 0.12; row 2 of the new one is 0.32.
  const double offset = 0.12 - 0.32;
  for (int k = 0; k < 6; ++k) {
    const ChunkPlayer::Step step = player.Play();
    const double share = k < 4 ? (4 - k) / 5.0 : 0;
    EXPECT_NEAR(step.blended[3], step.requested[3] + share * offset, 1e-12) << k;
    EXPECT_EQ(step.fading, k < 4);
    EXPECT_EQ(step.blended[6], step.requested[6]) << "the gripper switches at once";
    EXPECT_EQ(step.policy[3], step.requested[3]) << "the residual's reference is not faded";
  }
}

TEST(ChunkPlayerTest, AChunkInTimeIsPlayedExactly) {
  Player player;
  ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
  for (int i = 0; i < 10; ++i) player.Play();
  ASSERT_EQ(player.Take(Chunk(1, 10, 0.3)), ChunkVerdict::kTaken);
  const ChunkPlayer::Step step = player.Play();
  EXPECT_FALSE(step.fading);
  EXPECT_EQ(step.blended[0], 0.3);
}

TEST(ChunkPlayerTest, ASwitchDuringAFadeHasNoJump) {
  Player player({.fade_steps = 4});
  ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
  for (int i = 0; i < 11; ++i) player.Play();
  ASSERT_EQ(player.Take(Chunk(1, 10, 0.4)), ChunkVerdict::kTaken);
  player.Play();
  const double last = player.Play().blended[0];
  ASSERT_EQ(player.Take(Chunk(2, 11, 0.0)), ChunkVerdict::kTaken);
  EXPECT_LT(std::abs(player.Play().blended[0] - last), 0.4 / 5 + 0.02);
}

TEST(ChunkPlayerTest, RefusesWhatMustNotBePlayed) {
  Player player;
  ArmChunk chunk = Chunk(0, 0);
  chunk.rows = 0;
  EXPECT_EQ(player.Take(chunk), ChunkVerdict::kWrongShape);
  chunk = Chunk(0, 0);
  chunk.requested[49][3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(player.Take(chunk), ChunkVerdict::kNotFinite);
  chunk = Chunk(0, 0);
  EXPECT_EQ(player.Offer(chunk, 40 * kTick_ns, {}), ChunkVerdict::kTooOld);
  EXPECT_EQ(player.Take(Chunk(0, 0, 0.6)), ChunkVerdict::kJump);
  chunk.episode = 1;
  EXPECT_EQ(player.Take(chunk), ChunkVerdict::kOutdated) << "another episode's";
  EXPECT_EQ(player.Take(Chunk(0, 5)), ChunkVerdict::kOutdated) << "of the future";
  ASSERT_EQ(player.Take(Chunk(3, 0)), ChunkVerdict::kTaken);
  EXPECT_EQ(player.Take(Chunk(2, 0)), ChunkVerdict::kOutdated) << "older than the one that plays";
  EXPECT_EQ(player.Take(Chunk(3, 0)), ChunkVerdict::kOutdated) << "twice";
  for (int i = 0; i < 20; ++i) player.Play();
  EXPECT_EQ(player.Take(Chunk(4, 0)), ChunkVerdict::kUsedUp);
}

TEST(ChunkPlayerTest, AJumpLeavesThePlayingChunkAlone) {
  Player player;
  ASSERT_EQ(player.Take(Chunk(0, 0)), ChunkVerdict::kTaken);
  for (int i = 0; i < 3; ++i) player.Play();
  EXPECT_EQ(player.Take(Chunk(1, 3, 2.0)), ChunkVerdict::kJump);
  EXPECT_EQ(player.Play().row, 3);
}

}  // namespace
}  // namespace robostress
