// A control step of LIBERO's scenes, the goal's evaluation included, allocates nothing.
#include <gtest/gtest.h>

#include "sim_worker/libero/libero_sim_task.h"
#include "tests/common/libero/shared_data.h"
#include "tests/sim_worker/allocation_counter.h"

namespace robostress::libero {
namespace {

TEST(LiberoStep, AllocatesNothing) {
  if (!CountsAllocations()) GTEST_SKIP() << "a sanitizer owns malloc";
  SKIP_WITHOUT_SHARED_DATA();
  // A drawer, an object in a basket, a knob and a pot on a burner: every kind of goal.
  for (const auto& [suite, index] :
       {std::pair("libero_goal", 0), {"libero_object", 0}, {"libero_10", 2}}) {
    for (const Stepping stepping : {Stepping::kFast, Stepping::kParity}) {
      UnitConfig unit;
      unit.suite = suite;
      unit.scenario = "nominal";
      unit.libero_root = LiberoTree();
      unit.robosuite_root = RobosuiteTree();
      unit.sim.stepping = stepping;
      unit.sim.settle_steps = 0;
      const auto task = LiberoSimTask::Create(unit, index);
      ASSERT_TRUE(task.ok()) << task.status();
      ASSERT_TRUE((*task)->Reset(0).ok());
      const Eigen::VectorXf command = Eigen::VectorXf::Constant(7, 0.3f);
      ASSERT_TRUE((*task)->Step(command).ok());
      const long before = Allocations();
      for (int i = 0; i < 5; ++i) {
        if (!(*task)->Step(command).ok()) FAIL();
      }
      EXPECT_EQ(Allocations(), before) << suite;
    }
  }
}

}  // namespace
}  // namespace robostress::libero
