#include "sim_worker/libero/libero_expert.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "sim_worker/libero/expert_grasp.h"
#include "sim_worker/libero/expert_view.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

UnitConfig UnitOf(const std::string& suite) {
  UnitConfig unit;
  unit.suite = suite;
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  return unit;
}

std::unique_ptr<LiberoSimTask> Make(const std::string& suite, int task) {
  auto made = LiberoSimTask::Create(UnitOf(suite), task);
  EXPECT_TRUE(made.ok()) << made.status();
  return made.ok() ? *std::move(made) : nullptr;
}

// Success within the task's horizon from an initial state.
bool Solves(LiberoSimTask& task, int state) {
  EXPECT_TRUE(task.Reset(state).ok());
  const auto expert = MakeExpertPolicy(task);
  EXPECT_TRUE(expert.ok()) << expert.status();
  if (!expert.ok()) return false;
  for (int step = 0; step < task.horizon() && !task.Success(); ++step) {
    const auto chunk = (*expert)->Predict({}, step);
    EXPECT_TRUE(chunk->actions.allFinite());
    EXPECT_TRUE(task.Step(chunk->actions.row(0).transpose()).ok());
  }
  return task.Success();
}

// docs/results/libero-experts.md has all fifty states; here one of each, of which a few may fail.
TEST(LiberoExpert, SolvesTheFortyTasks) {
  SKIP_WITHOUT_SHARED_DATA();
  std::vector<std::string> failed;
  for (const std::string& suite : LiberoSuites()) {
    for (int task = 0; task < 10; ++task) {
      const auto made = Make(suite, task);
      ASSERT_NE(made, nullptr);
      if (!Solves(*made, 25)) failed.push_back(absl::StrCat(suite, " ", task));
    }
  }
  EXPECT_LE(failed.size(), 3u) << ::testing::PrintToString(failed);
}

// A drawer that stands askew is longer and wider along the world's axes than it is: seen so, there
// is room nowhere in it.
TEST(LiberoExpert, FindsRoomInADrawerThatStandsAskew) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = Make("libero_spatial", 4);
  ASSERT_NE(task, nullptr);
  for (const int state : {10, 15, 34}) EXPECT_TRUE(Solves(*task, state)) << state;
  ASSERT_TRUE(task->Reset(10).ok());
  const ExpertView view(*task);
  const int bowl = task->scene().objects.at("akita_black_bowl_1").body;
  const Eigen::Vector3d half(0.008, 0.008, 0.02);
  const Eigen::Vector3d inside = view.Body(bowl) + Eigen::Vector3d(0, 0, 0.05);
  EXPECT_FALSE(view.Blocked(inside, half, bowl));
  EXPECT_TRUE(view.Blocked(inside, half + Eigen::Vector3d(0.13, 0.13, 0), bowl));
  EXPECT_TRUE(view.Blocked(inside - Eigen::Vector3d(0, 0, 0.05), half, bowl));  // the floor
}

// What it does follows from the state alone: another one, asked half-way, says the same.
TEST(LiberoExpert, RemembersNothing) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = Make("libero_goal", 8);
  ASSERT_NE(task, nullptr);
  ASSERT_TRUE(task->Reset(0).ok());
  const auto first = MakeExpertPolicy(*task);
  ASSERT_TRUE(first.ok()) << first.status();
  for (int step = 0; step < 30; ++step) {
    const auto chunk = (*first)->Predict({}, step);
    const auto second = MakeExpertPolicy(*task);
    ASSERT_EQ(chunk->actions, (*second)->Predict({}, 0)->actions) << step;
    ASSERT_TRUE(task->Step(chunk->actions.row(0).transpose()).ok());
  }
}

TEST(LiberoExpert, HoldsABowlByItsRimAndACanAroundItsMiddle) {
  SKIP_WITHOUT_SHARED_DATA();
  auto task = Make("libero_goal", 8);
  ASSERT_NE(task, nullptr);
  ASSERT_TRUE(task->Reset(0).ok());
  const ExpertView goal(*task);
  const LiberoObject& bowl = task->scene().objects.at("akita_black_bowl_1");
  const Eigen::Vector3d at = goal.Body(bowl.body);
  const Grasp rim = FindGrasp(goal, bowl, at);
  EXPECT_NEAR((rim.p - at).head<2>().norm(), 0.045, 0.006);
  EXPECT_EQ(rim.width, 0);

  task = Make("libero_object", 0);
  ASSERT_NE(task, nullptr);
  ASSERT_TRUE(task->Reset(0).ok());
  const ExpertView object(*task);
  const LiberoObject& can = task->scene().objects.at("alphabet_soup_1");
  const Grasp around = FindGrasp(object, can, object.Body(can.body));
  EXPECT_LT((around.p - object.Body(can.body)).head<2>().norm(), 0.008);
  EXPECT_NEAR(around.width, 0.063, 0.004);
  EXPECT_FALSE(object.Holds(can.body));
  EXPECT_TRUE(object.Stands(can.body));
}

TEST(LiberoExpert, SaysWhichPartOfAGoalItCannotReach) {
  SKIP_WITHOUT_SHARED_DATA();
  auto unit = UnitOf("libero_goal");
  auto task = LiberoSimTask::Create(unit, 7);
  ASSERT_TRUE(task.ok()) << task.status();
  const_cast<LiberoScene&>((*task)->scene()).problem.goal[0].predicate = "turnoff";
  EXPECT_THAT(std::string(MakeExpertPolicy(**task).status().message()),
              ::testing::HasSubstr("none reaches (turnoff flat_stove_1)"));
}

}  // namespace
}  // namespace robostress::libero
