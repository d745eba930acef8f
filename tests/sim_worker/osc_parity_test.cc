// The controller, the arm's dynamics and the reset against trajectories that robosuite 1.4.0 and
// LIBERO wrote (shared/oracles/libero): 90 control steps with rotations, pauses, gripper toggles
// and a clipped tail. Our scene holds the robot alone, so the arm can be compared until it touches
// something there.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "common/safetensors.h"
#include "sim_worker/panda_mjcf.h"
#include "sim_worker/panda_sim.h"

namespace robostress {
namespace {

std::string OracleFile(const std::string& name) {
  const char* shared = std::getenv("ROBOSTRESS_SHARED");
  return (std::filesystem::path(shared != nullptr ? shared : "../shared") / "oracles/libero" / name)
      .string();
}

PandaScene RobosuiteScene() {
  PandaScene scene;
  scene.impratio = 20;
  scene.iterations = 100;
  scene.tolerance = 1e-8;
  scene.density = 1.2;
  scene.viscosity = 2e-5;
  return scene;
}

// Ten settle steps, which include the reset's quirks: rounding only. A controller whose first goal
// is the initial state's pose instead of the home posture's is off by 2e-3 rad here.
constexpr int kSettleSteps = 10;
constexpr double kExact = 1e-13;  // [rad]
// From the first rotation on: robosuite converts quaternions in single precision, we in double.
constexpr double kFloat32Rotation = 2e-8;  // [rad]
// In all 24 recorded trajectories the arm meets nothing before control step 37.
constexpr int kFreeSteps = 36;

class OscParity : public testing::TestWithParam<const char*> {};

TEST_P(OscParity, FollowsRobosuitesTrajectory) {
  const std::string path = OracleFile(std::string(GetParam()) + ".safetensors");
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is absent; set ROBOSTRESS_SHARED";
  const SafetensorsFile file = SafetensorsFile::Open(path).value();
  const std::vector<double> actions = file.ReadDoubles("actions", {90, 7}).value();
  const std::vector<double> qpos = file.ReadDoubles("qpos").value();
  const std::vector<double> home = file.ReadDoubles("initial_joint", {7}).value();
  const size_t nq = qpos.size() / 91;

  const SharedModel model =
      CompileModel("robot alone", ComposePandaScene(RobosuiteScene())).value();
  auto sim = PandaSim::Create(model, {}).value();
  ASSERT_TRUE(sim->Reset(absl::MakeSpan(qpos.data(), 9),
                         Eigen::Map<const Eigen::Matrix<double, 7, 1>>(home.data()))
                  .ok());
  for (int step = 0; step < kFreeSteps; ++step) {
    ASSERT_TRUE(
        sim->Step(Eigen::Map<const Eigen::Matrix<double, 7, 1>>(&actions[7 * step]).cast<float>())
            .ok());
    for (int i = 0; i < 7; ++i) {
      EXPECT_NEAR(sim->data().qpos[i], qpos[nq * (step + 1) + i],
                  step < kSettleSteps ? kExact : kFloat32Rotation)
          << "joint " << i + 1 << " after control step " << step;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Tasks, OscParity,
                         testing::Values("libero_goal_00", "libero_goal_03", "libero_object_02",
                                         "libero_spatial_00", "libero_10_02", "libero_10_03"));

}  // namespace
}  // namespace robostress
