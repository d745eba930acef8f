#include "sim_worker/libero/libero_expert.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/suites.h"
#include "sim_worker/libero/catalog.h"
#include "sim_worker/libero/expert_grasp.h"
#include "sim_worker/libero/expert_view.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;

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

// Success within the task's horizon from where it stands.
bool Plays(LiberoSimTask& task) {
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

bool Solves(LiberoSimTask& task, int state) {
  EXPECT_TRUE(task.Reset(state).ok());
  return Plays(task);
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

// The task with another goal.
std::unique_ptr<LiberoSimTask> MakeWithGoal(const std::string& suite, int task,
                                            const std::string& goal) {
  const std::string name = (*LiberoTaskNames(suite))[task];
  const std::string root = LiberoTree() + "/libero/libero/";
  const fs::path folder = fs::path(::testing::TempDir()) / absl::StrCat("goal_", suite, task);
  fs::remove_all(folder);
  fs::create_directories(folder);
  std::string text = *ReadFile(absl::StrCat(root, "bddl_files/", suite, "/", name, ".bddl"));
  const size_t begin = text.find("(:goal");
  text = absl::StrCat(text.substr(0, begin), "(:goal (And ", goal, ")))\n");
  EXPECT_TRUE(WriteFileAtomically((folder / "other.bddl").string(), text).ok());
  fs::copy_file(absl::StrCat(root, "init_files/", suite, "/", name, ".pruned_init"),
                folder / "other.pruned_init");
  UnitConfig unit = UnitOf(suite);
  unit.libero_tasks = folder.string();
  unit.suite = *AddTaskFolder(unit.libero_tasks);
  auto made = LiberoSimTask::Create(unit, 0);
  EXPECT_TRUE(made.ok()) << made.status();
  return made.ok() ? *std::move(made) : nullptr;
}

// The goals of LIBERO-90 that none of the forty tasks has, from where the joint is at the other
// end.
TEST(LiberoExpert, OpensAMicrowaveAndTurnsAStoveOff) {
  SKIP_WITHOUT_SHARED_DATA();
  const struct {
    const char *suite, *goal, *object;
    int task;
    double from;
  } cases[] = {{"libero_10", "(Open microwave_1)", "microwave_1", 9, 0},
               {"libero_goal", "(Turnoff flat_stove_1)", "flat_stove_1", 7, 1.2}};
  for (const auto& c : cases) {
    const auto task = MakeWithGoal(c.suite, c.task, c.goal);
    ASSERT_NE(task, nullptr);
    int solved = 0;
    for (int state = 0; state < 5; ++state) {
      ASSERT_TRUE(task->Reset(state).ok());
      const mjModel& model = task->sim().model();
      const mjData& data = task->sim().data();
      std::vector<double> qpos(data.qpos, data.qpos + model.nq);
      const int joint = task->scene().objects.at(c.object).joints.at(0);
      qpos[model.jnt_qposadr[joint]] = c.from;
      const std::vector<double> qvel(model.nv, 0);
      ASSERT_TRUE(task->ResetTo(qpos, qvel, LiberoSimTask::HomePosture()).ok());
      EXPECT_FALSE(task->goal().Evaluate(task->sim().data())[0]) << c.goal;
      solved += Plays(*task);
    }
    EXPECT_GE(solved, 4) << c.goal;
  }
}

TEST(LiberoExpert, SaysWhichPartOfAGoalItCannotReach) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = Make("libero_goal", 7);
  ASSERT_NE(task, nullptr);
  const_cast<LiberoScene&>(task->scene()).problem.goal[0].predicate = "up";
  EXPECT_THAT(std::string(MakeExpertPolicy(*task).status().message()),
              ::testing::HasSubstr("none reaches (up flat_stove_1)"));
}

}  // namespace
}  // namespace robostress::libero
