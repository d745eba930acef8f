#include <string>
#include <utility>

#include "common/rollout/rollout.h"
#include "gtest/gtest.h"
#include "sim_worker/suites/embedded_task.h"
#include "sim_worker/suites/goals.h"

namespace robostress {
namespace {

std::unique_ptr<EmbeddedTask> MakeTask(const std::string& suite, int task) {
  UnitConfig unit;
  unit.suite = suite;
  absl::StatusOr<std::unique_ptr<EmbeddedTask>> made = EmbeddedTask::Create(unit, task);
  EXPECT_TRUE(made.ok()) << made.status();
  return std::move(made).value();
}

class ExpertSolves : public ::testing::TestWithParam<std::pair<const char*, int>> {};

// One task per skill; the table of all forty is measured by `robostress record --eval`.
TEST_P(ExpertSolves, OneEpisodeWithinTheHorizon) {
  const auto task = MakeTask(GetParam().first, GetParam().second);
  const auto expert = MakeExpertPolicy(*task);
  ASSERT_TRUE(expert.ok());
  uint64_t sequence = 0;
  RolloutOptions options;
  options.initial_state = 12;
  const absl::StatusOr<EpisodeRecord> episode =
      RunEpisode({GetParam().second, 0}, options, *task, **expert, sequence);
  ASSERT_TRUE(episode.ok()) << episode.status();
  EXPECT_TRUE(episode->success) << task->instruction();
  EXPECT_LT(episode->steps, task->horizon());
}

INSTANTIATE_TEST_SUITE_P(
    Skills, ExpertSolves,
    ::testing::Values(std::pair("tabletop_spatial", 2), std::pair("tabletop_spatial", 6),
                      std::pair("tabletop_object", 0), std::pair("tabletop_object", 8),
                      std::pair("tabletop_goal", 0), std::pair("tabletop_goal", 4),
                      std::pair("tabletop_goal", 5), std::pair("tabletop_long", 0),
                      std::pair("tabletop_long", 5)));

TEST(Expert, CommandsKeepHeadroomAndAreNotSwallowedByFriction) {
  const auto task = MakeTask("tabletop_goal", 1);
  ASSERT_TRUE(task->Reset(0).ok());
  for (int i = 0; i < task->horizon() && !task->Success(); ++i) {
    const Eigen::VectorXf command = task->Decide().command;
    EXPECT_LE(command.head<3>().norm(), 0.81);
    EXPECT_LE(command.segment<3>(3).cwiseAbs().maxCoeff(), 0.41);
    EXPECT_EQ(std::abs(command[6]), 1);
    ASSERT_TRUE(task->Step(command).ok());
  }
}

TEST(Expert, ADecisionDependsOnTheStateAlone) {
  const auto task = MakeTask("tabletop_object", 0);
  ASSERT_TRUE(task->Reset(0).ok());
  for (int i = 0; i < 30; ++i) ASSERT_TRUE(task->Step(task->Decide().command).ok());
  const auto snapshot = task->sim().Save();
  const Eigen::VectorXf before = task->Decide().command;
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(task->Step(task->Decide().command).ok());
  task->sim().Restore(*snapshot);
  EXPECT_EQ(task->Decide().command, before);
}

TEST(Expert, AnObjectInTheGripperIsNotPlaced) {
  const auto task = MakeTask("tabletop_goal", 1);
  ASSERT_TRUE(task->Reset(0).ok());
  bool was_held = false;
  for (int i = 0; i < task->horizon() && !task->Success(); ++i) {
    const bool held = task->sim().held_body() == task->model().BodyId("pot");
    was_held |= held;
    EXPECT_FALSE(held && GoalHolds(task->model(), task->sim(), task->model().task().goals[0]));
    ASSERT_TRUE(task->Step(task->Decide().command).ok());
  }
  EXPECT_TRUE(was_held);
  EXPECT_TRUE(task->Success());
}

TEST(Expert, AnObjectThatIsHeldWhereItBelongsIsNotPlacedYet) {
  const auto task = MakeTask("tabletop_goal", 1);  // pot on plate
  ASSERT_TRUE(task->Reset(0).ok());
  const int pot = task->model().BodyId("pot");
  for (int i = 0; i < task->horizon() && task->sim().held_body() != pot; ++i)
    ASSERT_TRUE(task->Step(task->Decide().command).ok());
  ASSERT_EQ(task->sim().held_body(), pot);
  // The plate comes to the pot.
  mjData& data = task->sim().mutable_data();
  const Goal& goal = task->model().task().goals[0];
  const Eigen::Vector3d way =
      task->model().Position(data, "pot") - task->model().RegionCenter(data, goal);
  const int plate = task->sim().model().body_mocapid[task->model().BodyId("plate")];
  ASSERT_GE(plate, 0);
  for (int k = 0; k < 3; ++k) data.mocap_pos[3 * plate + k] += way[k];
  mj_forward(&task->sim().model(), &data);
  ASSERT_EQ(task->sim().held_body(), pot);
  ASSERT_LT((task->model().Position(data, "pot") - task->model().RegionCenter(data, goal)).norm(),
            1e-6);
  ASSERT_GT(task->model().Upright(data, "pot"), 0.95);
  EXPECT_FALSE(GoalHolds(task->model(), task->sim(), goal));
}

TEST(Expert, GraspsAgainAfterTheObjectIsLost) {
  const auto task = MakeTask("tabletop_spatial", 0);
  ASSERT_TRUE(task->Reset(1).ok());
  int step = 0;
  while (step < task->horizon() && task->sim().held_body() < 0) {
    ASSERT_TRUE(task->Step(task->Decide().command).ok());
    ++step;
  }
  Eigen::VectorXf open = Eigen::VectorXf::Zero(7);
  open[6] = -1;
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(task->Step(open).ok());
  EXPECT_LT(task->sim().held_body(), 0);
  while (step < task->horizon() && !task->Success()) {
    ASSERT_TRUE(task->Step(task->Decide().command).ok());
    ++step;
  }
  EXPECT_TRUE(task->Success());
}

}  // namespace
}  // namespace robostress
