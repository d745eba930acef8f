#include "sim_worker/panda_sim.h"

#include <gtest/gtest.h>

#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

TEST(PandaSim, HoldsItsPoseInClean) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const RobotState before = sim->Measure();
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  const RobotState after = sim->Measure();
  EXPECT_LT((after.tool.p_base_tool - before.tool.p_base_tool).norm(), 1e-3);
  EXPECT_LT(after.tool.q_base_tool.angularDistance(before.tool.q_base_tool), 2e-3);
  EXPECT_LT(after.dq.norm(), 1e-3);
  EXPECT_NEAR(after.gripper, 0.08, 1e-3);
}

TEST(PandaSim, MovesAlongTheCommandedDirection) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const RobotState before = sim->Measure();
  for (int i = 0; i < 16; ++i) ASSERT_TRUE(sim->Step(Command(0, 1, 0)).ok());
  const Eigen::Vector3d moved = sim->Measure().tool.p_base_tool - before.tool.p_base_tool;
  EXPECT_GT(moved.y(), 0.1);
  EXPECT_LT(std::hypot(moved.x(), moved.z()), 0.02);
}

}  // namespace
}  // namespace robostress
