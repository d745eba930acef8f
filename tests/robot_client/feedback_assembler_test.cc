#include "robot_client/feedback_assembler.h"

#include <gtest/gtest.h>

#include <cmath>

#include "adapter/pseudo_target.h"
#include "adapter/residual.h"
#include "robot_client/joint_residual.h"

namespace robostress {
namespace {

constexpr double kPeriod = 1.0 / 30;

// A played tick: policy at tick / 100, arm at tick / 100 - 0.02, sent exactly.
TickRecord Played(int tick, int chunk, int row) {
  TickRecord r;
  r.tick = static_cast<uint64_t>(tick);
  r.start_ns = static_cast<int64_t>(tick / 30.0 * 1e9);
  r.state = ClientState::kRun;
  r.flags = kTickPlayed | kTickSent | kTickFresh;
  r.episode = 0;
  r.chunk = chunk;
  r.row = row;
  r.prediction_id = static_cast<uint64_t>(chunk) + 1;
  r.policy.fill(tick / 100.0);
  r.policy[6] = 0.03;
  r.requested = r.blended = r.corrected = r.sent = r.policy;
  r.position.fill(tick / 100.0 - 0.02);
  r.position[6] = 0.01;
  r.stamp_ns = r.start_ns - 2'000'000;
  return r;
}

std::vector<ExecutedChunk> AddAll(FeedbackAssembler& assembler,
                                  const std::vector<TickRecord>& records) {
  std::vector<ExecutedChunk> chunks;
  for (const TickRecord& r : records) {
    if (auto chunk = assembler.Add(r)) chunks.push_back(*std::move(chunk));
  }
  return chunks;
}

std::vector<TickRecord> TwoChunks() {
  std::vector<TickRecord> records;
  for (int i = 0; i < 12; ++i) records.push_back(Played(i, 0, i));
  for (int i = 12; i < 22; ++i) records.push_back(Played(i, 1, i - 10));
  TickRecord end = Played(22, -1, -1);
  end.state = ClientState::kEnabled;
  end.flags = kTickSent | kTickFresh;
  records.push_back(end);
  return records;
}

TEST(FeedbackAssemblerTest, ReportsTheRowsThatWerePlayedWithTheStateOneStepLater) {
  FeedbackAssembler assembler({}, kPeriod);
  const std::vector<ExecutedChunk> chunks = AddAll(assembler, TwoChunks());
  ASSERT_EQ(chunks.size(), 2u);
  EXPECT_EQ(chunks[0].first_step, 0);
  EXPECT_EQ(chunks[0].steps.size(), 12u);
  EXPECT_EQ(chunks[1].first_step, 2) << "entered two rows late";
  EXPECT_EQ(chunks[1].steps.size(), 10u);
  EXPECT_EQ(chunks[1].prediction_id, 2u);
  EXPECT_FALSE(chunks[0].last_of_episode);
  EXPECT_TRUE(chunks[1].last_of_episode);
  // eta = q_{t+1} - q_ref_t = ((t + 1) / 100 - 0.02) - t / 100, gripper 0.
  const Eigen::MatrixXd eta = ChunkResidual(chunks[1], {.space = ResidualSpace::kJoint});
  for (int i = 0; i < 10; ++i) {
    for (int j = 0; j < 6; ++j) EXPECT_NEAR(eta(i, j), -0.01, 1e-7);
    EXPECT_EQ(eta(i, 6), 0);
  }
  const Eigen::MatrixXf target = PseudoTarget(chunks[1], eta);
  EXPECT_NEAR(target(3, 2), 0.15 + 0.01, 1e-6);
  EXPECT_FLOAT_EQ(target(3, 6), 0.03f) << "the gripper's own target stays";
}

TEST(FeedbackAssemblerTest, SevenJointsAndAGripperAreReported) {
  FeedbackAssembler assembler({}, kPeriod, {}, {7, true});
  std::vector<TickRecord> records = TwoChunks();
  for (TickRecord& r : records) {
    r.policy[6] = r.requested[6] = r.blended[6] = r.corrected[6] = r.sent[6] = 0.5;
    r.policy[7] = r.requested[7] = r.blended[7] = r.corrected[7] = r.sent[7] = 0.03;
    r.position[6] = 0.4;
    r.position[7] = 0.01;
  }
  records[13].sent[6] -= 0.02;  // limiter
  records[14].sent[7] -= 0.02;  // of the gripper: no residual
  const std::vector<ExecutedChunk> chunks = AddAll(assembler, records);
  ASSERT_EQ(chunks.size(), 2u);
  EXPECT_EQ(chunks[0].steps[0].before.q.size(), 7);
  EXPECT_EQ(chunks[0].steps[0].policy_command.size(), 8);
  EXPECT_EQ(chunks[0].steps[0].before.gripper, 0.01);
  ASSERT_TRUE(ValidateExecutedChunk(chunks[0], 8, ResidualSpace::kJoint).ok());
  const Eigen::MatrixXd eta = ChunkResidual(chunks[0], {.space = ResidualSpace::kJoint});
  EXPECT_NEAR(eta(3, 6), -0.1, 1e-7);
  EXPECT_EQ(eta(3, 7), 0) << "gripper excluded";
  EXPECT_TRUE(chunks[1].IsMasked(1)) << "the limiter moved J7";
  EXPECT_FALSE(chunks[1].IsMasked(2));
  JointResidual residual;
  residual.Add(chunks[0], {});
  double displacement = 0;
  for (int i = 0; i < 12; ++i) displacement += 6 * i * i * 1e-4 + 0.25;
  EXPECT_NEAR(residual.value(), std::sqrt(12 * (6 * 1e-4 + 0.01) / displacement), 1e-6);
}

TEST(FeedbackAssemblerTest, ReportsTheWholeChunkAndMasksStepsThatFadeOrLimiterMoved) {
  std::vector<TickRecord> records = TwoChunks();
  for (int i = 12; i < 15; ++i) records[i].blended[1] += 0.02;  // fade
  records[18].sent[4] -= 0.02;                                  // limiter
  FeedbackAssembler assembler({}, kPeriod);
  const std::vector<ExecutedChunk> chunks = AddAll(assembler, records);
  ASSERT_EQ(chunks.size(), 2u);
  EXPECT_TRUE(chunks[0].masked.empty());
  EXPECT_EQ(chunks[1].first_step, 2);
  ASSERT_EQ(chunks[1].steps.size(), 10u);
  const std::vector<bool> expected{true,  true, true,  false, false,
                                   false, true, false, false, false};
  EXPECT_EQ(chunks[1].masked, expected);
  EXPECT_EQ(assembler.counters().steps, 22u);
  EXPECT_EQ(assembler.counters().steps_masked, 4u);
  const Eigen::MatrixXd eta = ChunkResidual(chunks[1], {.space = ResidualSpace::kJoint});
  for (int i = 0; i < 10; ++i) EXPECT_NEAR(eta(i, 4), expected[i] ? 0 : -0.01, 1e-7) << i;
  JointResidual residual;
  residual.Add(chunks[1], ArmVector{});
  EXPECT_EQ(residual.steps, 6);
}

TEST(FeedbackAssemblerTest, SmallMovesAndTheObserverMaskNothing) {
  std::vector<TickRecord> records = TwoChunks();
  for (int i = 0; i < 22; ++i) {
    records[i].blended[1] += 0.004;
    records[i].corrected = records[i].blended;
    for (int j = 0; j < 6; ++j) records[i].corrected[j] -= 0.05;  // the observer at its limit
    records[i].sent = records[i].corrected;
  }
  FeedbackAssembler assembler({}, kPeriod);
  const std::vector<ExecutedChunk> chunks = AddAll(assembler, records);
  ASSERT_EQ(chunks.size(), 2u);
  EXPECT_EQ(assembler.counters().steps_masked, 0u);
  EXPECT_NEAR(chunks[0].steps[3].policy_command[0], 0.03, 1e-6)
      << "the policy's target, before the observer";
  EXPECT_NEAR(chunks[0].steps[3].sent_command[0], -0.02, 1e-6);
}

TEST(FeedbackAssemblerTest, AStepWithoutItsMeasurementIsMasked) {
  std::vector<TickRecord> records = TwoChunks();
  records[5].flags &= ~uint32_t{kTickFresh};  // nothing new came: step 4 has no state after it
  records[15].flags |= kTickLost;             // records between are missing: step 14
  FeedbackAssembler assembler({}, kPeriod);
  AddAll(assembler, records);
  EXPECT_EQ(assembler.counters().steps_masked, 2u);
  FeedbackAssembler skipped({}, kPeriod);
  records = TwoChunks();
  for (size_t i = 8; i < records.size(); ++i) records[i].start_ns += 33'000'000;  // a skipped tick
  AddAll(skipped, records);
  EXPECT_EQ(skipped.counters().steps_masked, 1u);
}

TEST(FeedbackAssemblerTest, AChunkWithoutAWholeStepIsNotReported) {
  std::vector<TickRecord> records = TwoChunks();
  for (int i = 12; i < 22; ++i) records[i].sent[0] += 0.1;
  FeedbackAssembler assembler({}, kPeriod);
  EXPECT_EQ(AddAll(assembler, records).size(), 1u);
  EXPECT_EQ(assembler.counters().chunks_empty, 1u);
}

TEST(JointResidualTest, IsTheRootOfSummedSquaresAgainstTheChunksStart) {
  FeedbackAssembler assembler({}, kPeriod);
  const std::vector<ExecutedChunk> chunks = AddAll(assembler, TwoChunks());
  JointResidual residual;
  residual.Add(chunks[1], ArmVector{0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0});
  double displacement = 0;
  for (int t = 12; t < 22; ++t) displacement += std::pow(t / 100.0 - 0.08, 2);
  EXPECT_NEAR(residual.value(), std::sqrt(10 * 1e-4 / displacement), 1e-5);
  EXPECT_EQ(residual.steps, 10);
  EXPECT_EQ(JointResidual{}.value(), 0);
}

}  // namespace
}  // namespace robostress
