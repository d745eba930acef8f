#include "sim_worker/libero/libero_task.h"

#include <gmock/gmock.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/so3.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "tests/libero/shared_data.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr int kOpenMiddleDrawer = 0, kBowlOnPlate = 8;  // of libero_goal

UnitConfig GoalUnit() {
  UnitConfig unit;
  unit.suite = "libero_goal";
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  return unit;
}

std::string ErrorOf(const UnitConfig& unit, int task) {
  const absl::StatusOr<std::unique_ptr<SimTask>> result = MakeLiberoTask(unit, task);
  return result.ok() ? "made" : std::string(result.status().message());
}

// A copy of a tree in which single files can be damaged.
class DamagedTree {
 public:
  explicit DamagedTree(const std::string& source)
      : path_(fs::temp_directory_path() / absl::StrCat("robostress_libero_", getpid())) {
    fs::remove_all(path_);
    fs::copy(source, path_, fs::copy_options::recursive);
    for (const auto& entry : fs::recursive_directory_iterator(path_)) {
      fs::permissions(entry, fs::perms::owner_all, fs::perm_options::add);
    }
    fs::permissions(path_, fs::perms::owner_all, fs::perm_options::add);
  }
  ~DamagedTree() { fs::remove_all(path_); }
  std::string path() const { return path_.string(); }
  void Remove(const std::string& file) { ASSERT_TRUE(fs::remove(path_ / file)) << file; }
  void Write(const std::string& file, const std::string& text) {
    std::ofstream(path_ / file) << text;
  }

 private:
  fs::path path_;
};

int Successes(SimTask& task, PolicyEndpoint& expert, const std::vector<int>& states) {
  int successes = 0;
  for (int state : states) {
    EXPECT_TRUE(task.Reset(state).ok());
    EXPECT_TRUE(expert.StartEpisode({0, state}).ok());
    EXPECT_FALSE(task.Success());
    for (int step = 0; step < task.horizon() && !task.Success(); ++step) {
      const absl::StatusOr<PredictedChunk> chunk = expert.Predict({}, step);
      EXPECT_TRUE(chunk.ok()) << chunk.status();
      const absl::Status stepped = task.Step(chunk->actions.row(0).transpose());
      EXPECT_TRUE(stepped.ok()) << stepped;
    }
    successes += task.Success();
  }
  return successes;
}

TEST(LiberoTaskTest, ExpertsSolveTheBowlAndTheDrawer) {
  SKIP_WITHOUT_SHARED_DATA();
  for (int index : {kBowlOnPlate, kOpenMiddleDrawer}) {
    const absl::StatusOr<std::unique_ptr<SimTask>> task = MakeLiberoTask(GoalUnit(), index);
    ASSERT_TRUE(task.ok()) << task.status();
    const absl::StatusOr<std::unique_ptr<PolicyEndpoint>> expert = (*task)->MakeExpert();
    ASSERT_TRUE(expert.ok()) << expert.status();
    EXPECT_EQ(Successes(**task, **expert, {0, 25, 49}), 3) << (*task)->instruction();
  }
}

TEST(LiberoTaskTest, ResetIsReproducibleAndStartsFromTheStoredRow) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit();
  unit.sim.settle_steps = 0;
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task =
      LiberoSimTask::Create(unit, kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  ASSERT_TRUE((*task)->Reset(3).ok());
  const int nq = (*task)->scene().model->nq;
  const double* row = (*task)->init_states().row(3);
  for (int i = 0; i < nq; ++i) EXPECT_EQ((*task)->sim().data().qpos[i], row[1 + i]) << i;

  const Eigen::VectorXf command = Eigen::VectorXf::Constant(7, 0.3f);
  std::vector<double> first;
  for (int run = 0; run < 2; ++run) {
    ASSERT_TRUE((*task)->Reset(3).ok());
    for (int i = 0; i < 5; ++i) ASSERT_TRUE((*task)->Step(command).ok());
    const double* qpos = (*task)->sim().data().qpos;
    if (run == 0) first.assign(qpos, qpos + nq);
    for (int i = 0; i < nq; ++i) EXPECT_EQ(qpos[i], first[i]) << i;
  }
  EXPECT_THAT((*task)->Reset(50).message(), HasSubstr("initial state 50 does not exist"));
  EXPECT_THAT((*task)->Reset(-1).message(), HasSubstr("initial state -1 does not exist"));
}

TEST(LiberoTaskTest, ObservesInTheOriginalsConventions) {
  SKIP_WITHOUT_SHARED_DATA();
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task =
      LiberoSimTask::Create(GoalUnit(), kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  ASSERT_TRUE((*task)->Reset(0).ok());
  PolicySpec spec;
  const absl::StatusOr<Observation> observation = (*task)->Observe(spec);
  ASSERT_TRUE(observation.ok()) << observation.status();
  EXPECT_EQ(observation->instruction, "put the bowl on the plate");
  EXPECT_TRUE(observation->views.empty()) << "renders only what the spec asks for";
  const Eigen::VectorXf& state = observation->proprioception;
  ASSERT_EQ(state.size(), 8);
  const RobotState measured = *(*task)->Measure();
  const Eigen::Vector3d base(-0.66, 0, 0.912);  // world frame, where RobotState has the base's
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(state[i], measured.tool.p_base_tool[i] + base[i], 1e-6);
  const Eigen::Vector3d rotation = state.segment<3>(3).cast<double>();
  EXPECT_LT(RotationBetween(ExpSo3(rotation), measured.tool.q_base_tool).norm(), 1e-6);
  EXPECT_NEAR(state[6] - state[7], measured.gripper, 1e-7);
}

// The originals' 90 control steps, from their reset. Commands pass through float here, and
// PandaSim's fast stepping solves contacts from another warm start: 1e-6 rad is what that leaves
// where no contact bifurcates.
TEST(LiberoTaskTest, FollowsTheOriginalsTrajectory) {
  SKIP_WITHOUT_SHARED_DATA();
  const std::string stem = SharedFolder() + "/oracles/libero/libero_goal_00";
  if (!fs::exists(stem + ".safetensors")) GTEST_SKIP() << stem << " is absent";
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task = LiberoSimTask::Create(GoalUnit(), 0);
  ASSERT_TRUE(task.ok()) << task.status();
  const nlohmann::json facts = nlohmann::json::parse(*ReadFile(stem + ".json"));
  std::vector<FixturePose> poses;
  for (const auto& [fixture, pose] : facts["fixture_pose"].items()) {
    poses.push_back(
        {fixture, pose[0].get<std::array<double, 3>>(), pose[1].get<std::array<double, 4>>()});
  }
  ASSERT_TRUE((*task)->MoveFixtures(poses).ok());
  const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(stem + ".safetensors");
  ASSERT_TRUE(oracle.ok()) << oracle.status();
  const std::vector<double> start = *oracle->ReadDoubles("init_state"),
                            actions = *oracle->ReadDoubles("actions");
  const std::vector<double> qpos = *oracle->ReadDoubles("qpos"),
                            home = *oracle->ReadDoubles("initial_joint");
  const int nq = (*task)->scene().model->nq;
  const Eigen::Matrix<double, 7, 1> posture =
      Eigen::Map<const Eigen::Matrix<double, 7, 1>>(home.data());
  ASSERT_TRUE((*task)->sim().Reset(absl::MakeConstSpan(start.data() + 1, nq), posture).ok());
  double arm = 0, rest = 0;
  for (size_t step = 0; step < actions.size() / 7; ++step) {
    const Eigen::VectorXf command =
        Eigen::Map<const Eigen::VectorXd>(actions.data() + 7 * step, 7).cast<float>();
    ASSERT_TRUE((*task)->Step(command).ok());
    EXPECT_FALSE((*task)->Success()) << step;
    for (int i = 0; i < nq; ++i) {
      const double error = std::abs((*task)->sim().data().qpos[i] - qpos[(step + 1) * nq + i]);
      (i < 7 ? arm : rest) = std::max(i < 7 ? arm : rest, error);
    }
  }
  std::printf("after %zu control steps: arm %.2g rad, everything else %.2g\n", actions.size() / 7,
              arm, rest);
  EXPECT_LT(arm, 1e-6);
  EXPECT_LT(rest, 1e-6);
}

TEST(LiberoTaskTest, SampledFixturesAreReproducibleAndStayInTheirRegions) {
  SKIP_WITHOUT_SHARED_DATA();
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task =
      LiberoSimTask::Create(GoalUnit(), kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  const LiberoScene& scene = (*task)->scene();
  const std::vector<FixturePose> a = SampleFixtures(scene, 7), b = SampleFixtures(scene, 7),
                                 c = SampleFixtures(scene, 8);
  ASSERT_EQ(a.size(), 3u);
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].pos, b[i].pos);
    EXPECT_NE(a[i].pos, c[i].pos);
    for (int k = 0; k < 2; ++k)
      EXPECT_NEAR(a[i].pos[k], scene.centred_fixtures[i].pos[k], 0.01) << "regions are 2 cm wide";
    EXPECT_EQ(a[i].pos[2], scene.centred_fixtures[i].pos[2]);
  }
  // The heights that the originals computed for their draw.
  EXPECT_NEAR(scene.centred_fixtures[0].pos[2], 0.905, 1e-12);
  EXPECT_NEAR(scene.centred_fixtures[2].pos[2], 0.92, 1e-12);
}

TEST(LiberoTaskTest, BadInputNamesTheFileAndTheRemedy) {
  UnitConfig unit;
  unit.suite = "libero_goal";
  unit.libero_root = "/nowhere";
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("--libero-root /nowhere"));
  SKIP_WITHOUT_SHARED_DATA();
  unit = GoalUnit();
  EXPECT_THAT(ErrorOf(unit, 10),
              HasSubstr("task 10 of suite 'libero_goal' does not exist; tasks are 0 to 9"));
  unit.suite = "libero_90";
  EXPECT_THAT(ErrorOf(unit, 0),
              HasSubstr("'libero_90' is not a LIBERO suite; known: libero_spatial"));
  unit.suite = "libero_goal";
  unit.robosuite_root = LiberoTree();
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("expected a robosuite 1.4 checkout"));
  unit.robosuite_root.clear();
  unsetenv("ROBOSUITE_ROOT");
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("give --robosuite-root DIR or set ROBOSUITE_ROOT"));
}

TEST(LiberoTaskTest, AMissingCollisionMeshIsAnErrorAndAMissingVisualIsNot) {
  SKIP_WITHOUT_SHARED_DATA();
  DamagedTree robosuite(RobosuiteTree());
  UnitConfig unit = GoalUnit();
  unit.robosuite_root = robosuite.path();
  robosuite.Remove("robosuite/models/assets/mounts/meshes/rethink_mount/pedestal.stl");
  const absl::StatusOr<std::unique_ptr<SimTask>> task = MakeLiberoTask(unit, 0);
  EXPECT_TRUE(task.ok()) << task.status();
  robosuite.Remove("robosuite/models/assets/robots/panda/meshes/link5.stl");
  EXPECT_THAT(ErrorOf(unit, 0),
              ::testing::AllOf(HasSubstr("collision mesh 'robot0_link5' is missing"),
                               HasSubstr("link5.stl")));
  robosuite.Write("robosuite/models/assets/grippers/panda_gripper.xml", "<mujoco><worldbody>");
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("panda_gripper.xml:1: not XML"));
}

}  // namespace
}  // namespace robostress::libero
